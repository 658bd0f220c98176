"""Who may use the console: names, origins, tokens."""

import pytest
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from drcli.web.security import MOST_TRIES, Guard, cookie_name

TOKEN = "a-token-of-twenty-letters"
HERE = "http://127.0.0.1:8100"


async def app(scope, receive, send):
    """Says that it was reached."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.close"})
        return
    await PlainTextResponse("reached")(scope, receive, send)


def page(token=None, base=HERE, *, here_only=False, **options):
    guarded = Guard(app, token, here_only=here_only)
    return TestClient(guarded, base_url=base, follow_redirects=False, **options)


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1:8100", "127.0.0.1", "localhost:8100", "LOCALHOST:9000", "[::1]:8100", "[::1]"],
)
def test_names_of_this_machine_are_answered_also_through_a_forwarded_port(host):
    assert page().get("/", headers={"host": host}).text == "reached"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8100",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8100",
        "127.0.0.1@evil.example",
        "10.0.0.5:8100",
        "[::2]:8100",
        "[::1].evil.example",
        "0.0.0.0:8100",
        "",
        "127.0.0.1, evil.example",
    ],
)
def test_names_of_others_are_refused(host):
    answer = page().get("/", headers={"host": host})

    assert answer.status_code == 421
    assert answer.json()["error"]["message"].startswith("This console does not answer")


def test_two_names_are_refused():
    guarded = Guard(app, None)
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request"}

    headers = [(b"host", b"127.0.0.1"), (b"host", b"evil.example")]
    scope = {"type": "http", "method": "GET", "path": "/", "headers": headers}
    scope["query_string"] = b""
    coroutine = guarded(scope, receive, send)
    with pytest.raises(StopIteration):
        coroutine.send(None)
    assert sent[0]["status"] == 421


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
@pytest.mark.parametrize(
    "origin",
    [
        None,
        "null",
        "https://evil.example",
        "http://127.0.0.1:3000",
        "http://localhost:8100",
        "http://127.0.0.1:8100.evil.example",
        "file://",
    ],
)
def test_changes_are_refused_unless_our_own_page_asks(method, origin):
    headers = {} if origin is None else {"origin": origin}

    assert page().request(method, "/api/x", headers=headers).status_code == 403


def test_changes_of_our_own_page_are_accepted_also_through_a_forwarded_port():
    assert page().post("/", headers={"origin": HERE}).status_code == 200
    forwarded = {"host": "localhost:9999", "origin": "http://localhost:9999"}
    assert page().post("/", headers=forwarded).status_code == 200


@pytest.mark.parametrize("origin", [None, "null", "https://evil.example", "http://127.0.0.1:1"])
def test_a_websocket_of_another_site_is_refused(origin):
    headers = {} if origin is None else {"origin": origin}

    with (
        pytest.raises(WebSocketDisconnect) as refused,
        page().websocket_connect("/ws", headers={"host": "127.0.0.1:8100", **headers}),
    ):
        pass
    assert refused.value.code == 1008


def test_our_own_websocket_is_accepted():
    headers = {"host": "127.0.0.1:8100", "origin": HERE}
    with page().websocket_connect("/ws", headers=headers) as opened:
        assert opened.receive()["type"] == "websocket.close"


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
@pytest.mark.parametrize("mode", ["no-cors", "cors", "websocket"])
def test_what_another_site_embeds_is_refused(site, mode):
    headers = {"sec-fetch-site": site, "sec-fetch-mode": mode}

    assert page().get("/stream", headers=headers).status_code == 403


def test_a_link_from_another_site_opens_the_page():
    headers = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}

    assert page().get("/", headers=headers).status_code == 200


def test_every_answer_tells_the_browser_what_it_may_do():
    for answer in (page().get("/"), page().get("/", headers={"host": "evil.example"})):
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"


def test_another_machine_needs_the_token_and_keeps_it_in_a_cookie():
    other = page(TOKEN, "http://10.0.0.5:8100")
    refused = other.get("/")
    assert refused.status_code == 401
    assert "token" in refused.json()["error"]["message"]

    entered = other.get("/enter", params={"token": TOKEN})

    assert (entered.status_code, entered.headers["location"]) == (303, "/")
    cookie = entered.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert "secure" not in cookie  # it would not come back over http
    assert "max-age=31536000" in cookie  # a bookmark works after the browser was closed
    assert other.get("/").text == "reached"


def test_the_cookie_stays_with_https():
    entered = page(TOKEN, "https://10.0.0.5").get("/enter", params={"token": TOKEN})

    assert "secure" in entered.headers["set-cookie"].lower()


def test_a_websocket_needs_the_token_too():
    headers = {"host": "10.0.0.5:8100", "origin": "http://10.0.0.5:8100"}
    with (
        pytest.raises(WebSocketDisconnect) as refused,
        page(TOKEN).websocket_connect("/ws", headers=headers),
    ):
        pass
    assert refused.value.code == 1008

    cookie = {"cookie": f"{cookie_name(TOKEN)}={TOKEN}"}
    with page(TOKEN).websocket_connect("/ws", headers={**headers, **cookie}) as opened:
        assert opened.receive()["type"] == "websocket.close"


@pytest.mark.parametrize("here_only", [True, False])
@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/app.js",
        "/api/folder",
        "/stream?worker=1",
        "/vendor/x.css",
        "/none",
        "/enter/",
        "//enter",
    ],
)
def test_this_machine_needs_the_token_too_for_everything(here_only, path):
    here = page(TOKEN, here_only=here_only)
    assert here.get(path).status_code == 401
    assert here.get(path, headers={"cookie": f"{cookie_name(TOKEN)}=wrong"}).status_code == 401
    assert here.post(path, headers={"origin": HERE}).status_code == 401

    assert here.get("/enter", params={"token": TOKEN}).status_code == 303
    assert here.get(path).text == "reached"


def test_with_a_token_a_console_of_this_machine_still_answers_to_its_own_names_only():
    cookie = {"cookie": f"{cookie_name(TOKEN)}={TOKEN}"}
    here = page(TOKEN, here_only=True)

    assert here.get("/", headers={**cookie, "host": "localhost:9000"}).text == "reached"
    assert here.get("/", headers={**cookie, "host": "evil.example"}).status_code == 421
    assert here.post("/", headers={**cookie, "origin": "http://evil.example"}).status_code == 403


def test_a_browser_without_the_token_gets_a_page_that_says_where_it_is_found():
    browser = {"accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    answer = page(TOKEN, here_only=True).get("/", headers=browser)

    assert answer.status_code == 401
    assert answer.headers["content-type"].startswith("text/html")
    assert answer.headers["cache-control"] == "no-store"
    for told in ("This console needs its token.", "dr console", 'name="token"'):
        assert told in answer.text
    assert TOKEN not in answer.text
    program = page(TOKEN, here_only=True).get("/api/folder").json()["error"]
    assert program["message"] == "This console needs its token."
    assert "dr console" in program["remedy"]
    assert "dr console start" in program["remedy"]


@pytest.mark.parametrize(
    ("site", "asks"), [("cross-site", 1), ("same-site", 1), ("same-origin", 0), ("none", 0)]
)
def test_a_link_from_elsewhere_with_which_a_browser_sends_no_cookie_is_asked_for_once_more(
    site, asks
):
    link = {"accept": "text/html", "sec-fetch-site": site, "sec-fetch-mode": "navigate"}

    answer = page(TOKEN, here_only=True).get("/", headers=link)

    assert answer.text.count('http-equiv="refresh"') == asks


def test_pictures_for_players_take_the_token_from_their_address_and_nothing_else_does():
    here = page(TOKEN, "http://10.0.0.5:8100")

    assert here.get("/stream", params={"token": TOKEN, "worker": 1}).text == "reached"
    assert here.get("/stream", params={"token": "wrong"}).status_code == 401
    for path in ("/", "/api/folder", "/stream/"):
        assert here.get(path, params={"token": TOKEN}).status_code == 401
    for _ in range(MOST_TRIES):
        here.get("/stream", params={"token": "guess"})
    assert here.get("/stream", params={"token": TOKEN}).text == "reached"


def test_another_user_of_this_machine_who_guesses_does_not_shut_out_its_owner():
    here = page(TOKEN, here_only=True)
    for _ in range(3 * MOST_TRIES):
        assert here.get("/enter", params={"token": "guess"}).status_code == 401

    assert here.get("/enter", params={"token": TOKEN}).status_code == 303


def test_without_a_token_there_is_nothing_to_enter():
    assert page().get("/enter").text == "reached"


def test_the_form_asks_for_a_token_without_inline_code():
    form = page(TOKEN).get("/enter")

    assert form.headers["content-type"].startswith("text/html")
    assert "<script" not in form.text
    assert "style=" not in form.text


@pytest.mark.parametrize("given", ["wrong", "Ä" * 30, "\x00", TOKEN + "x", TOKEN.upper()])
def test_a_wrong_token_gives_no_cookie(given):
    answer = page(TOKEN).get("/enter", params={"token": given})

    assert answer.status_code == 401
    assert "set-cookie" not in answer.headers
    assert "dr console start" in answer.text


def test_who_guesses_must_wait_and_the_right_token_need_not(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("drcli.web.security.time.monotonic", lambda: now[0])
    guarded = Guard(app, TOKEN)
    guessing = TestClient(guarded, client=("10.0.0.9", 1), follow_redirects=False)
    other = TestClient(guarded, client=("10.0.0.8", 1), follow_redirects=False)
    wrong = {"token": "guess"}
    for _ in range(MOST_TRIES):
        assert guessing.get("/enter", params=wrong).status_code == 401

    assert guessing.get("/enter", params=wrong).status_code == 429
    assert guessing.get("/enter", params={"token": TOKEN}).status_code == 303
    assert other.get("/enter", params=wrong).status_code == 401
    now[0] += 61.0
    assert guessing.get("/enter", params=wrong).status_code == 401


@pytest.mark.parametrize(("given", "status"), [(TOKEN, 303), ("wrong", 401), ("x" * 10_000, 200)])
def test_the_form_sends_its_token_where_no_history_keeps_it(given, status):
    here = page(TOKEN, "http://10.0.0.5:8100")

    answer = here.post("/enter", data={"token": given}, headers={"origin": "http://10.0.0.5:8100"})

    assert answer.status_code == status
    assert 'method="post"' in here.get("/enter").text


def test_a_browser_that_is_refused_reads_a_page():
    here = page(TOKEN, "http://other.example", here_only=True)

    answer = here.get("/", headers={"accept": "text/html"})

    assert answer.status_code == 421
    assert answer.headers["content-type"].startswith("text/html")
    assert "does not answer to that name" in answer.text


def test_tokens_of_two_consoles_of_a_machine_do_not_replace_each_other():
    assert cookie_name("one") != cookie_name("two")
    assert "one" not in cookie_name("one").removeprefix("dr_console")
