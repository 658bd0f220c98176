"""`dr tracks`: what there is, what it looks like, and how more of it gets in."""

import http.server
import json
import socket
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drcli.base.errors import Aborted, NotYet, StorageError
from drcli.cli.app import main
from drcli.cli.fetch_tracks import bring_tracks
from drcli.config import track_names
from drcli.config.loading import load_settings
from drcli.tracks import community, tracks_folder
from drsim.errors import TrackError
from drsim.track.worlds import load_track

CSV = "x,y\n" + "\n".join(
    f"{4 * np.cos(a):.4f},{3 * np.sin(a):.4f}" for a in np.linspace(0, 2 * np.pi, 60)
)


def run(capsys, *args: str) -> tuple[int, str, str]:
    code = 0
    try:
        main(["tracks", *args])
    except SystemExit as ended:
        code = int(ended.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def report(out: str) -> dict:
    found: dict = json.loads(out.splitlines()[-1])
    return found


@pytest.fixture
def route(working_folder: Path) -> Path:
    file = working_folder / "loop.csv"
    file.write_text(CSV)
    return file


@pytest.fixture
def web(monkeypatch):
    """A server on this machine, and what it offers by path: content, error code or redirect."""
    offers: dict[str, bytes | int | str] = {}

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            content = offers.get(self.path, 404)
            if isinstance(content, str):
                self.send_response(302)
                self.send_header("Location", content)
            else:
                self.send_response(content if isinstance(content, int) else 200)
            self.end_headers()
            self.wfile.write(content if isinstance(content, bytes) else b"")

        def log_message(self, *_: object) -> None:
            pass

    monkeypatch.setenv("no_proxy", "*")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield offers, f"http://127.0.0.1:{server.server_address[1]}/routes"
    server.shutdown()
    thread.join()
    server.server_close()


def test_the_list_names_what_is_built_in_and_where_more_would_lie(working_folder, capsys):
    code, out, _ = run(capsys, "list")
    _, told, _ = run(capsys, "list", "--json")

    assert code == 0
    assert "reinvent_base" in out
    assert "your own are in tracks/." in out
    assert "zoo-0, zoo-1 and so on" in out
    facts = {track["name"]: track for track in report(told)["tracks"]}
    assert facts["reinvent_base"]["length_m"] == pytest.approx(17.7, abs=0.1)
    assert facts["reinvent_base"]["source"] == "own"


def test_a_track_is_shown_with_its_map_and_picture(working_folder, capsys):
    picture = working_folder / "map.png"

    code, out, _ = run(capsys, "show", "reinvent_base", "--png", str(picture))

    lines = out.splitlines()
    assert code == 0
    assert len(lines) <= 22
    assert any("S" in line for line in lines)
    assert "counterclockwise" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["reinvent_base.npy", "reinvent_base_cw.npy"])
def test_a_track_that_is_built_in_may_be_called_by_a_file_name(working_folder, capsys, name):
    code, out, _ = run(capsys, "show", name, "--json")

    assert code == 0
    assert report(out)["facts"]["name"] == name.removesuffix(".npy")


def test_a_generated_circuit_is_shown_without_a_file(working_folder, capsys):
    code, out, _ = run(capsys, "show", "zoo-17", "--json")

    assert code == 0
    assert report(out)["facts"]["length_m"] == round(load_track("zoo-17").length_m, 3)
    assert report(out)["facts"]["about"] == "A generated circuit."


def test_a_circuit_of_choice_is_kept_as_a_route_file(working_folder, capsys):
    wishes = ["--length", "25", "--width", "0.8", "--tightest-turn", "0.7"]

    code, out, _ = run(capsys, "generate", "mine", *wishes, "--seed", "2", "--json")
    again, _, words = run(capsys, "generate", "mine")

    assert code == 0
    assert report(out)["length_m"] == pytest.approx(25.0, abs=0.02)
    assert report(out)["width_m"] == pytest.approx(0.8, abs=0.02)
    assert load_track("mine", working_folder / "tracks").closed
    assert again == 3
    assert "The track mine already exists" in words


def test_a_circuit_of_choice_that_hides_a_generated_one_is_told(working_folder, capsys):
    code, _, words = run(capsys, "generate", "zoo-3", "--seed", "7")

    assert code == 0
    assert "zoo-3 is also a built-in track" in words


def test_an_added_track_can_be_raced_on_by_its_name(route, working_folder, capsys):
    code, out, _ = run(capsys, "add", str(route), "--width", "0.8", "--json")

    assert code == 0
    assert report(out)["width_m"] == pytest.approx(0.8, abs=0.02)
    assert load_track("loop", working_folder / "tracks").closed
    assert [file.name for file in (working_folder / "tracks").iterdir()] == ["loop.npy"]


def test_an_added_track_takes_the_place_of_a_built_in_one_and_says_so(
    route, working_folder, capsys
):
    code, out, words = run(capsys, "add", str(route), "--name", "reinvent_base", "--json")
    _, shown, _ = run(capsys, "show", "reinvent_base", "--json")
    _, listed, _ = run(capsys, "list", "--json")

    file = str(working_folder / "tracks" / "reinvent_base.npy")
    assert code == 0
    assert report(out)["source"] == file
    assert "reinvent_base is also a built-in track" in words
    assert report(shown)["facts"]["source"] == file
    sources = {track["name"]: track["source"] for track in report(listed)["tracks"]}
    assert sources["reinvent_base"] == sources["reinvent_wood"] == file


def test_shown_and_listed_are_the_waypoints_of_the_file_repeated_ones_included(
    route, working_folder, capsys
):
    run(capsys, "add", str(route))
    file = working_folder / "tracks" / "loop.npy"
    rows = np.load(file)
    np.save(working_folder / "mine.npy", np.insert(rows, 7, rows[7], axis=0))

    _, added, _ = run(capsys, "add", str(working_folder / "mine.npy"), "--json")
    _, shown, _ = run(capsys, "show", "mine", "--json")
    _, words, _ = run(capsys, "show", "mine")

    assert f"{len(rows) + 1} waypoints, 0.20 m apart; 8 repeats 7" in words
    assert report(added)["repeated"] == [8]
    assert report(added)["waypoints"] == len(rows) + 1
    assert report(shown)["facts"]["waypoints"] == len(rows) + 1
    assert len(np.load(working_folder / "tracks" / "mine.npy")) == len(rows) + 1


def test_a_track_is_replaced_only_when_told(route, capsys):
    run(capsys, "add", str(route))

    refused, _, words = run(capsys, "add", str(route))
    forced, _, _ = run(capsys, "add", str(route), "--force", "--width", "0.7")

    assert (refused, forced) == (3, 0)
    assert "--force" in words


def test_a_folder_that_cannot_be_written_is_named(route, working_folder, capsys, monkeypatch):
    monkeypatch.setenv("DR_TRACKS_DIR", str(route))

    code, _, words = run(capsys, "add", str(route))

    assert code == 3
    assert f"{route / 'loop.npy'} cannot be written" in words
    assert "DR_TRACKS_DIR" in words


def test_a_route_that_cannot_be_written_leaves_nothing_behind(route, working_folder, capsys):
    (working_folder / "tracks" / "loop.npy").mkdir(parents=True)

    code, _, words = run(capsys, "add", str(route), "--force")

    assert code == 3
    assert "cannot be written" in words
    assert [file.name for file in (working_folder / "tracks").iterdir()] == ["loop.npy"]


def test_a_full_disk_is_told_in_a_sentence(route, working_folder, capsys, monkeypatch):
    def refuse(track: object, file: Path) -> None:
        raise TrackError(f"{file}: it cannot be written (no space left). Make room.")

    monkeypatch.setattr(tracks_folder, "write_route", refuse)

    code, _, words = run(capsys, "add", str(route))

    assert code == 3
    assert "it cannot be written (no space left)." in words
    assert "Try: Make room." in words


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["show", "nowhere"], "Try: `dr-tracks list --all` shows all, `dr-tracks fetch`"),
        (["show", "reinvent_bsae"], "Did you mean reinvent_base? `dr-tracks list --all` shows all"),
        (["show", "nowhere.npy"], "nowhere.npy"),
        (["add", "loop.csv", "--length", "0"], "give --length"),
        (["add", "nothing.npy"], "nothing.npy"),
        (["add", "run.env"], "run.env"),
        (["add", "loop.csv", "--name", "a b"], "'a b' is not a valid track name"),
        (["add", "loop.csv", "--name", "../up"], "'../up' is not a valid track name"),
        (["add", "loop.csv", "--width", "-1"], "loop.csv"),
        (["show", "reinvent_base", "--png", "no/such/map.png"], "no/such/map.png cannot be"),
        (["line", "zoo-17"], "only that of a route file is"),
        (["limit", "zoo-17_cw"], "only that of a route file is"),
        (["generate", "new", "--length", "8", "--tightest-turn", "3"], "--length=8 is less than"),
        (["generate", "new", "--length", "7"], "--length=7 is outside 8 to 150 metres"),
        (["generate", "new", "--width", "nan"], "--width=nan is outside"),
        (["generate", "new", "--width", "1", "--tightest-turn", "0.5"], "--tightest-turn=0.56 or"),
        (["generate", "new", "--length", "8", "--tightest-turn", "1.1"], "60 tries"),
        (["generate", "a b"], "'a b' is not a valid track name"),
        (["fetch", "Oval_track", "--from", "ftp://x"], "ftp://x"),
        (["fetch", "Oval_track", "--from", "http://x:y"], "http://x:y"),
        (["fetch", "Oval_track", "--from", "http://[x"], "http://[x"),
        (["fetch", "Oval_track", "--from", "http://x y/"], "http://x y/"),
        (["fetch", "Oval_track", "--from", "https://"], "https://"),
        (["fetch", "../Oval_track"], "'../Oval_track' is not a valid track name"),
    ],
)
def test_bad_input_is_refused_in_a_sentence_with_a_remedy(route, capsys, arguments, sentence):
    code, _, words = run(capsys, *arguments)

    assert code == 3
    assert sentence in words
    assert "Try:" in words
    assert "Traceback" not in words


def test_a_route_is_fetched_checked_and_found_by_its_name(web, route, working_folder, capsys):
    offers, address = web
    run(capsys, "add", str(route), "--name", "made")
    offers["/routes/Far_track.npy"] = (working_folder / "tracks" / "made.npy").read_bytes()

    code, out, _ = run(capsys, "fetch", "Far_track", "--from", address, "--json")

    assert code == 0
    assert report(out)["source"] == str(working_folder / "tracks" / "Far_track.npy")
    assert load_track("Far_track", working_folder / "tracks").length_m > 10


def test_all_tracks_of_the_community_are_listed_and_fetched(
    web, route, working_folder, capsys, monkeypatch
):
    offers, address = web
    run(capsys, "add", str(route), "--name", "Oval_track")
    content = (working_folder / "tracks" / "Oval_track.npy").read_bytes()
    offers.update({f"/routes/{name}.npy": content for name in ("China_track", "Albert")})
    few = {name: track_names.community()[name] for name in ("China_track", "Oval_track", "Albert")}
    monkeypatch.setattr(track_names, "community", lambda: few)

    _, before, _ = run(capsys, "list", "--all", "--json")
    code, out, _ = run(capsys, "fetch", "--all", "--from", address, "--json")
    _, after, _ = run(capsys, "list", "--all")

    assert [
        (t["name"], t["console_name"], t["installed"]) for t in report(before)["community"]
    ] == [
        ("Albert", "Yun Speedway", False),
        ("China_track", "Shanghai Sudu", False),
        ("Oval_track", "Oval Track", True),
    ]
    assert code == 0
    assert [each["name"] for each in report(out)["tracks"]] == ["Albert", "China_track"]
    assert after.count("  yes\n") == 3


@pytest.mark.parametrize("words", [["fetch"], ["fetch", "--all", "Albert"]])
def test_fetch_wants_one_name_or_all(working_folder, capsys, words):
    assert run(capsys, *words)[0] == 2


@pytest.mark.parametrize(
    ("content", "code", "sentence"),
    [
        (None, 4, "There is no track Far_track at http"),
        (b"<html>not found</html>", 3, "Far_track.npy"),
        (b"x" * 1_000_001, 4, "larger than"),
    ],
)
def test_what_is_no_route_is_not_stored(web, working_folder, capsys, content, code, sentence):
    offers, address = web
    if content is not None:
        offers["/routes/Far_track.npy"] = content

    ended, _, words = run(capsys, "fetch", "Far_track", "--from", address)

    assert ended == code
    assert sentence in words
    assert not (working_folder / "tracks").exists()


def test_a_redirect_is_followed_on_the_web(web, route, working_folder, capsys):
    offers, address = web
    run(capsys, "add", str(route), "--name", "made")
    offers["/routes/Far_track.npy"] = "/elsewhere/made.npy"
    offers["/elsewhere/made.npy"] = (working_folder / "tracks" / "made.npy").read_bytes()

    code, _, _ = run(capsys, "fetch", "Far_track", "--from", address)

    assert code == 0
    assert (working_folder / "tracks" / "Far_track.npy").is_file()


@pytest.mark.parametrize("target", ["ftp://127.0.0.1:9/made.npy", "file:///etc/hostname"])
def test_a_redirect_away_from_the_web_is_refused(web, working_folder, capsys, target):
    offers, address = web
    offers["/routes/Far_track.npy"] = target

    code, _, words = run(capsys, "fetch", "Far_track", "--from", address)

    assert code == 4
    assert "unknown url type: ftp" in words or "is not allowed" in words
    assert not (working_folder / "tracks").exists()


def test_a_redirect_in_a_circle_is_told_in_one_line(web, working_folder, capsys):
    offers, address = web
    offers["/routes/Far_track.npy"] = "/routes/Far_track.npy"

    code, _, words = run(capsys, "fetch", "Far_track", "--from", address)

    assert code == 4
    assert len(words.splitlines()) == 2
    assert "infinite loop" in words


def test_a_server_that_is_not_there_is_named(working_folder, capsys, monkeypatch):
    monkeypatch.setenv("no_proxy", "*")

    code, _, words = run(capsys, "fetch", "Far_track", "--from", "http://127.0.0.1:9/routes")

    assert code == 4
    assert "http://127.0.0.1:9/routes/Far_track.npy cannot be reached: Connection refused." in words


def test_a_fetched_route_can_get_another_name(web, route, working_folder, capsys):
    offers, address = web
    run(capsys, "add", str(route), "--name", "made")
    offers["/routes/reinvent_base.npy"] = (working_folder / "tracks" / "made.npy").read_bytes()

    code, out, _ = run(
        capsys, "fetch", "reinvent_base", "--from", address + "/", "--name", "theirs", "--json"
    )

    assert code == 0
    assert report(out)["name"] == "theirs"
    assert not (working_folder / "tracks" / "reinvent_base.npy").exists()


def test_the_address_can_be_set_once_for_all(web, working_folder, capsys, monkeypatch):
    _, address = web
    monkeypatch.setenv("DR_TRACKS_URL", address)

    code, _, words = run(capsys, "fetch", "Far_track")

    assert code == 4
    assert f"{address}/Far_track.npy" in words


@pytest.mark.parametrize(
    "listing",
    [
        b'<li><a href="Far_track.npy">Far_track.npy</a></li><a href="Near_loop.npy">',
        b'[{"name": "Far_track.npy", "type": "file"}, {"name": "Near_loop.npy"}]',
    ],
)
def test_a_misspelt_name_is_told_the_close_ones_that_the_server_lists(
    web, working_folder, capsys, listing
):
    offers, address = web
    offers["/routes/"] = listing

    code, _, words = run(capsys, "fetch", "far_trakc", "--from", address)

    assert code == 4
    assert "The closest names there are Far_track;" in words


def test_a_folder_of_a_repository_on_github_is_listed_where_github_lists_it(monkeypatch):
    asked: list[str] = []

    def download(address: str) -> bytes:
        asked.append(address)
        return b'[{"name": "Far_track.npy"}]'

    monkeypatch.setattr(community, "_download", download)

    remedy = community._similar("far_track", "https://raw.githubusercontent.com/some/one/HEAD/a/b")

    assert asked == ["https://api.github.com/repos/some/one/contents/a/b?ref=HEAD"]
    assert "Far_track" in remedy


def test_an_answer_that_says_no_is_repeated_to_the_racer(web, working_folder, capsys):
    offers, address = web
    offers["/routes/Far_track.npy"] = 503

    code, _, words = run(capsys, "fetch", "Far_track", "--from", address)

    assert code == 4
    assert "answered 503 Service Unavailable" in words
    assert "Try:" in words


def test_a_server_that_sends_drop_by_drop_is_given_up(web, working_folder, capsys, monkeypatch):
    offers, address = web
    offers["/routes/Far_track.npy"] = b"x" * 100
    clock = iter([0.0, 2 * community.PATIENCE_S])
    monkeypatch.setattr(community, "time", SimpleNamespace(monotonic=lambda: next(clock)))

    code, _, words = run(capsys, "fetch", "Far_track", "--from", address)

    assert code == 4
    assert "cannot be reached: it takes longer than 20 s" in words


def test_a_track_is_shown_and_fetched_by_its_name_in_consoles(
    web, route, working_folder, capsys, monkeypatch
):
    offers, address = web
    monkeypatch.setenv("DR_TRACKS_URL", address)
    run(capsys, "add", str(route), "--name", "made")
    content = (working_folder / "tracks" / "made.npy").read_bytes()
    offers.update({"/routes/China_track.npy": content, "/routes/Shanghai.npy": content})

    code, out, words = run(capsys, "fetch", "Shanghai", "--json")
    assert (code, report(out)["name"]) == (0, "China_track")
    assert words.startswith("Shanghai is the track China_track.")

    code, out, words = run(capsys, "show", "shanghai sudu", "--json")
    assert (code, report(out)["facts"]["name"]) == (0, "China_track")
    assert words.startswith("shanghai sudu is the track China_track.")

    code, out, words = run(capsys, "fetch", "Shanghai", "--from", address, "--json")
    assert (code, report(out)["name"], words) == (0, "Shanghai", "")


def test_a_misspelt_name_is_told_the_likely_one_where_no_server_answers(working_folder, capsys):
    code, _, words = run(capsys, "fetch", "Chna_track", "--from", "http://127.0.0.1:9")

    assert code == 4
    assert "Try: Did you mean China_track? Check the network" in words


def test_a_server_that_does_not_speak_http_is_named(working_folder, capsys, monkeypatch):
    monkeypatch.setenv("no_proxy", "*")
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            caller, _ = listener.accept()
            with caller:
                caller.recv(65_536)
                caller.sendall(b"SSH-2.0-none\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        port = listener.getsockname()[1]

        code, _, words = run(capsys, "fetch", "Far_track", "--from", f"http://127.0.0.1:{port}")

        thread.join()
    assert code == 4
    assert "cannot be reached" in words
    assert "Traceback" not in words


@pytest.fixture
def needs(web, working_folder, monkeypatch):
    """Settings that name a track of the community, which a server has."""
    offers, address = web
    track = load_track("reinvent_base")
    save = working_folder / "route.npy"
    np.save(save, np.hstack([track.center, track.inner, track.outer]))
    offers["/routes/Spain_track.npy"] = save.read_bytes()

    def load(fetches: str, world: str = "Spain_track"):
        (working_folder / "run.env").write_text(
            f"DR_WORLD_NAME={world}\nDR_TRACKS_URL={address}\nDR_TRACKS_FETCH={fetches}\n"
        )
        return load_settings(working_folder, environ={})

    return load


@pytest.fixture
def terminal(monkeypatch):
    """Somebody who sits there and answers."""

    def answer(text: str) -> None:
        monkeypatch.setattr("drcli.cli.prompts.may_ask", lambda: True)
        monkeypatch.setattr(
            sys, "stdin", SimpleNamespace(isatty=lambda: True, readline=lambda: text)
        )

    return answer


def test_a_start_fetches_a_track_of_the_community_where_the_setting_says_so(
    needs, working_folder, capsys
):
    settings = needs("always")

    bring_tracks(settings)
    bring_tracks(settings)  # it is here now

    assert (working_folder / "tracks" / "Spain_track.npy").exists()
    assert capsys.readouterr().err.count("Fetched Spain_track: 17.") == 1


def test_a_start_asks_on_a_terminal_before_it_fetches(needs, working_folder, terminal, capsys):
    terminal("y\n")

    bring_tracks(needs("ask"))

    assert "Download it now? [y/N]" in capsys.readouterr().err
    assert (working_folder / "tracks" / "Spain_track.npy").exists()


def test_who_says_no_fetches_nothing(needs, working_folder, terminal):
    terminal("\n")

    with pytest.raises(Aborted):
        bring_tracks(needs("ask"))

    assert not (working_folder / "tracks").exists()


@pytest.mark.parametrize("fetches", ["ask", "never"])
def test_without_a_terminal_or_against_the_setting_nothing_is_fetched(
    needs, working_folder, capsys, fetches
):
    bring_tracks(needs(fetches))

    assert not (working_folder / "tracks").exists()
    assert capsys.readouterr().err == ""


def test_a_start_that_reaches_no_server_names_the_command_that_fetches(
    needs, working_folder, monkeypatch
):
    monkeypatch.setenv("no_proxy", "*")
    settings = needs("always").replaced(tracks_url="http://127.0.0.1:9/routes")

    with pytest.raises(StorageError) as error:
        bring_tracks(settings)

    assert "`dr-tracks fetch Spain_track`" in error.value.remedy


def test_a_start_refuses_a_track_of_the_community_that_nobody_fetched(
    needs, working_folder, capsys
):
    needs("ask")
    code = 0
    try:
        main(["start-training", "-q"])
    except SystemExit as ended:
        code = int(ended.code or 0)

    words = capsys.readouterr().err
    assert code == 3
    assert "Spain_track" in words
    assert "`dr-tracks fetch Spain_track`" in words


def test_an_unattended_start_fetches_what_it_needs_without_a_question(needs, working_folder):
    bring_tracks(needs("ask"), unattended=True)

    assert (working_folder / "tracks" / "Spain_track.npy").exists()


def test_an_unattended_start_fetches_nothing_where_the_setting_forbids_it(needs, working_folder):
    bring_tracks(needs("never"), unattended=True)

    assert not (working_folder / "tracks").exists()


@pytest.mark.parametrize("answer", ["none", 503])
def test_an_unattended_start_waits_for_the_network_then_ends_so_that_it_is_tried_again(
    needs, web, capsys, answer
):
    offers, _ = web
    settings = needs("ask")
    if answer == "none":
        settings = settings.replaced(tracks_url="http://127.0.0.1:1/routes")
    else:
        offers["/routes/Spain_track.npy"] = answer

    with pytest.raises(NotYet) as end:
        bring_tracks(settings, unattended=True, patience_s=0.02)

    assert end.value.code == 75
    assert "Spain_track" in str(end.value)
    assert capsys.readouterr().err.count("Waiting for it") == 1


def test_a_track_that_the_server_does_not_have_is_not_waited_for(needs):
    with pytest.raises(StorageError, match="There is no track LGSWide") as end:
        bring_tracks(needs("ask", "LGSWide"), unattended=True, patience_s=900.0)

    assert end.value.code == 4
