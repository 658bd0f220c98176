"""`dr tracks`: what there is, what it looks like, and how more of it gets in."""

import http.server
import json
import threading
from pathlib import Path

import numpy as np
import pytest

from drcli.cli import main
from drsim.worlds import load_track

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
def web():
    """A server on this machine, and what it has to offer by path."""
    offers: dict[str, bytes] = {}

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            content = offers.get(self.path)
            self.send_response(404 if content is None else 200)
            self.end_headers()
            self.wfile.write(content or b"")

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
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
    assert str(working_folder / "tracks") in out
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


def test_an_added_track_can_be_raced_on_by_its_name(route, working_folder, capsys):
    code, out, _ = run(capsys, "add", str(route), "--width", "0.8", "--json")

    assert code == 0
    assert report(out)["width_m"] == pytest.approx(0.8, abs=0.02)
    assert load_track("loop", working_folder / "tracks").closed
    assert [file.name for file in (working_folder / "tracks").iterdir()] == ["loop.npy"]


def test_a_track_is_replaced_only_when_told(route, capsys):
    run(capsys, "add", str(route))

    refused, _, words = run(capsys, "add", str(route))
    forced, _, _ = run(capsys, "add", str(route), "--force", "--width", "0.7")

    assert (refused, forced) == (3, 0)
    assert "--force" in words


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["show", "nowhere"], "No world is called 'nowhere'"),
        (["add", "nothing.npy"], "nothing.npy"),
        (["add", "run.env"], "run.env"),
        (["add", "loop.csv", "--name", "a b"], "'a b' is no name for a track"),
        (["add", "loop.csv", "--name", "../up"], "'../up' is no name for a track"),
        (["add", "loop.csv", "--name", "reinvent_base"], "reinvent_base is built in"),
        (["add", "loop.csv", "--width", "-1"], "loop.csv"),
        (["show", "reinvent_base", "--png", "no/such/map.png"], "no/such/map.png cannot be"),
        (["fetch", "Oval_track", "--from", "ftp://x"], "ftp://x"),
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


def test_a_server_that_is_not_there_is_named(working_folder, capsys):
    code, _, words = run(capsys, "fetch", "Far_track", "--from", "http://127.0.0.1:9/routes")

    assert code == 4
    assert "http://127.0.0.1:9/routes/Far_track.npy cannot be reached" in words
