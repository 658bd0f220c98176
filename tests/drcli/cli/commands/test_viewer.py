"""The commands of the console: options of DeepRacer-for-Cloud, what they print and open."""

import json

import pytest

from drcli.cli import open_page
from drcli.web import viewer_process
from drcli.web.viewer_process import ViewerRecord, report_of

PAGE = "http://127.0.0.1:8100/enter?token=secret"


@pytest.fixture
def started(monkeypatch):
    """Consoles that were started, with their settings; `runs` is one that runs already."""
    calls = []

    def start(directory, config, *, again=False, environ=None):
        calls.append((config, again))
        token = "secret" if config.asks_token else ""
        record = ViewerRecord(4242, 1.0, config.host, config.port, token)
        return report_of(calls.runs or record, started=calls.runs is None)

    class Calls(list):
        runs = None

    calls = Calls()
    monkeypatch.setattr(viewer_process, "start_viewer", start)
    return calls


@pytest.fixture
def opened(monkeypatch):
    """Pages that were opened, with the program."""
    pages = []
    monkeypatch.setattr("drcli.cli.commands.viewer.open_page", lambda *call: pages.append(call))
    return pages


def test_the_address_is_printed_and_nothing_is_opened(dr, working_folder, started, opened, capsys):
    assert dr("start-viewer") == 0

    assert capsys.readouterr().out == f"{PAGE}\n"
    assert opened == []


def test_options_of_deepracer_for_cloud_are_accepted(dr, working_folder, started, opened):
    options = ["-w", "640", "-h", "480", "-q", "75", "-t", "/racecar/camera", "-p", "9000"]

    assert dr("start-viewer", *options, "-b", "firefox --new-tab") == 0
    assert dr("update-viewer", *options) == 0

    assert [(config.port, again) for config, again in started] == [(9000, False), (9000, True)]
    assert opened == [("http://127.0.0.1:9000/enter?token=secret", "firefox --new-tab")]


@pytest.mark.parametrize("option", [["-p", "0"], ["-p", "70000"], ["-w", "x"], ["-q", "0"], ["-h"]])
def test_wrong_options_are_refused(dr, working_folder, started, option):
    assert dr("start-viewer", *option) == 2
    assert started == []


def test_the_console_is_opened_unless_that_is_not_wanted(dr, working_folder, started, opened):
    dr("console")
    dr("console", "--no-open")
    dr("console", "--json")

    assert opened == [(PAGE, "")]


def test_a_console_that_runs_tells_its_address(dr, working_folder, monkeypatch, capsys):
    assert dr("console", "status") == 1
    assert "No console is running." in capsys.readouterr().err

    record = ViewerRecord(4242, 1.0, "127.0.0.1", 8100, "secret")
    monkeypatch.setattr(viewer_process, "running_viewer", lambda folder: record)

    assert dr("console", "status") == 0
    assert capsys.readouterr().out == f"{PAGE}\n"


def test_pictures_are_asked_for_with_long_options_and_h_is_help(
    dr, working_folder, started, capsys
):
    assert dr("console", "stream", "--width", "320", "--height", "240", "--quality", "50") == 0
    assert "&quality=50&width=320&height=240" in capsys.readouterr().out

    assert dr("console", "stream", "-h") == 0
    assert capsys.readouterr().out.startswith("Usage: dr console stream ")


@pytest.mark.parametrize("host", ["10.0.0.5", "127.0.0.1", "localhost"])
def test_an_address_with_a_token_comes_with_a_warning(
    dr, working_folder, started, capsys, monkeypatch, host
):
    monkeypatch.setenv("DR_WEBVIEWER_HOST", host)
    dr("start-viewer")

    printed = capsys.readouterr()
    assert printed.out == f"http://{host}:8100/enter?token=secret\n"
    assert "Keep it to yourself" in printed.err


def test_only_a_setting_leaves_the_token_away(dr, working_folder, started, capsys, monkeypatch):
    monkeypatch.setenv("DR_WEBVIEWER_AUTH", "none")
    dr("start-viewer")

    printed = capsys.readouterr()
    assert printed.out == "http://127.0.0.1:8100/\n"
    assert "Keep it to yourself" not in printed.err
    monkeypatch.setenv("DR_WEBVIEWER_HOST", "0.0.0.0")
    assert dr("start-viewer") == 3
    assert "would let every machine that reaches 0.0.0.0" in capsys.readouterr().err


def test_a_console_that_runs_without_a_token_is_told(dr, working_folder, started, capsys):
    started.runs = ViewerRecord(4242, 1.0, "127.0.0.1", 8100)  # of an earlier version
    dr("start-viewer")

    assert "asks for no token. `dr console restart`" in capsys.readouterr().err


def test_settings_that_a_running_console_does_not_have_are_said(
    dr, working_folder, started, capsys
):
    started.runs = ViewerRecord(4242, 1.0, "127.0.0.1", 34567, "secret")
    dr("start-viewer")
    assert "Warning" not in capsys.readouterr().err
    dr("start-viewer", "-p", "9000")

    printed = capsys.readouterr()
    assert printed.out == "http://127.0.0.1:34567/enter?token=secret\n"
    assert "port 34567" in printed.err
    assert "dr console restart" in printed.err


def test_wrong_settings_leave_a_running_console_alone(dr, working_folder, started, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=several\n")

    assert dr("update-viewer") == 3
    assert started == []


def test_every_worker_has_a_stream(dr, working_folder, started, capsys):
    dr("view-stream", "-w", "320", "-h", "240", "-q", "50")

    first, second = capsys.readouterr().out.splitlines()
    assert first == (
        "http://127.0.0.1:8100/stream?topic=/racecar/deepracer/kvs_stream"
        "&quality=50&width=320&height=240&token=secret"
    )
    assert second == first.replace("&token", "&worker=1&token")


def test_streams_as_json(dr, working_folder, started, capsys):
    camera = "/racecar/camera/zed/rgb/image_rect_color"
    dr("view-stream", "-t", camera, "--json")

    report = json.loads(capsys.readouterr().out)
    assert report["topic"] == camera
    assert len(report["urls"]) == 2


def test_a_topic_that_nothing_shows_is_refused(dr, working_folder, started, capsys):
    assert dr("view-stream", "-t", "/sub_camera") == 2
    assert "/racecar/deepracer/kvs_stream" in capsys.readouterr().err


def test_a_browser_that_does_not_start_is_one_sentence(dr, working_folder, started, capsys):
    assert dr("start-viewer", "-b", "/no/such/browser --new-tab") == 3

    error = capsys.readouterr().err
    assert "/no/such/browser --new-tab: this program does not start" in error
    assert "-b firefox" in error


def test_a_token_is_in_no_process_list(working_folder, monkeypatch):
    calls = []
    monkeypatch.setattr(open_page.subprocess, "Popen", lambda command, **_: calls.append(command))
    monkeypatch.setattr("webbrowser.open", lambda url: calls.append([url]))
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(open_page.sys, "platform", "linux")

    open_page.open_page(PAGE, "firefox --new-tab")
    open_page.open_page(PAGE)

    file = working_folder / "data" / "viewer" / "open.html"
    assert calls == [["firefox", "--new-tab", file.as_uri()], [file.as_uri()]]
    assert f'content="0; url={PAGE}"' in file.read_text()
    assert file.stat().st_mode & 0o077 == 0


def test_without_a_display_no_browser_is_opened(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(open_page.sys, "platform", "linux")
    monkeypatch.setattr("webbrowser.open", lambda url: pytest.fail("opened"))

    open_page.open_page("http://127.0.0.1:8100/")


def test_stop_all_stops_the_console_before_the_bucket(dr, working_folder, monkeypatch, capsys):
    order = []
    record = ViewerRecord(4242, 1.0, "127.0.0.1", 8100)
    monkeypatch.setattr(viewer_process, "stop_viewer", lambda _: order.append("console") or record)
    monkeypatch.setattr("drcli.run.stopping.server.stop", lambda *_: order.append("server") or True)
    (working_folder / "data").mkdir()

    assert dr("stop-all") == 0

    assert order == ["console", "server"]
    assert "Stopped the console." in capsys.readouterr().out
