"""The process of the console: its start, its end, and everything that is in its way."""

import json
import os
import signal
import socket
import threading
import urllib.error
import urllib.request
from contextlib import ExitStack
from dataclasses import replace
from urllib.parse import urljoin

import psutil
import pytest

from drcli.base.clock import wait_until
from drcli.base.errors import NotAvailable, SettingsError
from drcli.config.loading import load_settings
from drcli.web import viewer_process
from drcli.web.viewer_process import log_path, running_viewer, start_viewer, stop_viewer

RECORD = "data/viewer/viewer.json"


@pytest.fixture
def folder(working_folder, monkeypatch):
    """A racer's folder with a blank in its name, and an end for its console."""
    folder = working_folder / "my racer"
    folder.mkdir()
    for name in ("run.env", "system.env"):
        (folder / name).write_bytes((working_folder / name).read_bytes())
    monkeypatch.chdir(folder)
    yield folder
    stop_viewer(folder)


def web(folder, **flags):
    """Where the console of a folder listens: at a free port that nobody chose.

    Not at the usual one: other tests start consoles there at the same time. Nor at one that the
    system gives to connections.
    """
    given = {f"DR_{name.upper()}": str(value) for name, value in flags.items()}
    config = load_settings(folder, flags=given).web
    return (
        config if "webviewer_port" in flags else replace(config, port=20_000 + os.getpid() % 10_000)
    )


def free_port():
    """A port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def fetched(url, path="/"):
    """What a browser that follows a printed link is answered at a path."""
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with browser.open(url, timeout=20.0):
        pass
    with browser.open(urljoin(url, path), timeout=20.0) as answer:
        return answer.status, answer.read()


def test_it_runs_in_the_background_and_again_where_it_was(folder):
    where = web(folder)
    report = start_viewer(folder, where)
    assert report.started
    assert report.needs_token
    assert b"app.js" in fetched(report.url)[1]
    assert json.loads(fetched(report.url, "/api/folder")[1])["folder"] == str(folder)

    again = start_viewer(folder, where)
    assert (again.pid, again.url, again.started) == (report.pid, report.url, False)

    # Killed without a word: its record is stale, and pages find the new one at the same address.
    os.kill(report.pid, signal.SIGKILL)
    assert wait_until(lambda: running_viewer(folder) is None, patience_s=20.0)
    third = start_viewer(folder, where)
    assert (third.started, third.url) == (True, report.url)
    assert third.pid != report.pid

    updated = start_viewer(folder, where, again=True)
    assert (updated.started, updated.url) == (True, report.url)
    assert not psutil.pid_exists(third.pid) or running_viewer(folder).pid == updated.pid

    # Open connections do not keep it from its end.
    with ExitStack() as pages:
        for _ in range(5):
            pages.enter_context(socket.create_connection(("127.0.0.1", updated.port)))
        stopped = stop_viewer(folder)
    assert stopped.pid == updated.pid
    assert not (folder / RECORD).exists()
    assert stop_viewer(folder) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_the_process_shows_no_secret_and_is_given_them(folder, monkeypatch, host):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "canary-of-the-environment")
    report = start_viewer(folder, web(folder, webviewer_host=host))
    assert report.needs_token
    token = report.url.partition("token=")[2]
    process = psutil.Process(report.pid)

    shown = " ".join(process.cmdline())
    assert token not in shown
    assert "canary" not in shown
    with_secrets = folder.joinpath("data/logs/viewer.log").read_text()
    assert token not in with_secrets
    assert (folder / RECORD).stat().st_mode & 0o077 == 0
    assert (folder / "data/viewer/token.json").stat().st_mode & 0o077 == 0
    names = {"127.0.0.1": 401, "evil.example": 421 if host == "127.0.0.1" else 401}
    for name, status in names.items():
        request = urllib.request.Request(f"http://127.0.0.1:{report.port}/", headers={"Host": name})
        with pytest.raises(urllib.error.HTTPError) as refused:
            fetched(request)
        assert refused.value.code == status
        refused.value.close()
    stop_viewer(folder)
    # Bookmarks and cookies go on working.
    assert viewer_process._own_token(folder) == token


def test_without_a_token_only_by_its_setting(folder):
    report = start_viewer(folder, web(folder, webviewer_auth="none"))

    assert not report.needs_token
    assert fetched(report.url, "/api/folder")[0] == 200


def test_two_starts_at_once_make_one_console(folder):
    reports = []
    threads = [
        threading.Thread(target=lambda: reports.append(start_viewer(folder, web(folder))))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert len({report.pid for report in reports}) == 1
    assert sorted(report.started for report in reports) == [False, False, True]


def test_two_folders_have_two_consoles(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    for name in ("run.env", "system.env"):
        (other / name).write_bytes((folder / name).read_bytes())
    first, second = start_viewer(folder, web(folder)), start_viewer(other, web(other))
    try:
        assert first.port != second.port
        folders = [
            json.loads(fetched(each.url, "/api/folder")[1])["folder"] for each in (first, second)
        ]
        assert folders == [str(folder), str(other)]
    finally:
        assert stop_viewer(other).pid == second.pid
    assert running_viewer(folder).pid == first.pid


def test_a_port_that_somebody_chose_and_another_program_has_is_one_sentence(folder, dr, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(SettingsError, match=f"cannot listen on 127.0.0.1 port {port}") as taken:
            start_viewer(folder, web(folder, webviewer_port=port))
        assert dr("console", "start", "-p", str(port)) == 3

    assert "-p PORT, or another DR_WEBVIEWER_PORT" in taken.value.remedy
    assert "-p PORT" in capsys.readouterr().err
    assert not (folder / RECORD).exists()


def test_the_usual_port_gives_way(folder):
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        with viewer_process._bound(replace(web(folder), port=taken), taken) as bound:
            assert bound.getsockname()[1] != taken


def test_an_update_that_cannot_work_leaves_the_console_alone(folder):
    running = start_viewer(folder, web(folder))
    with socket.create_server(("127.0.0.1", 0)) as other, pytest.raises(SettingsError):
        start_viewer(folder, web(folder, webviewer_port=other.getsockname()[1]), again=True)

    assert running_viewer(folder).pid == running.pid


@pytest.mark.parametrize("host", ["192.0.2.77", "no-such-host.invalid"])
def test_an_address_of_another_machine_is_one_sentence(folder, host):
    with pytest.raises(SettingsError, match=f"cannot listen on {host}"):
        start_viewer(folder, web(folder, webviewer_host=host))


@pytest.mark.parametrize("content", ["", "{", "[]", '{"pid": "x"}', '{"pid": -1, "began_s": 0}'])
def test_a_damaged_record_is_none(folder, content):
    (folder / RECORD).parent.mkdir(parents=True)
    (folder / RECORD).write_text(content)

    assert running_viewer(folder) is None
    assert stop_viewer(folder) is None


def test_the_record_of_a_number_that_is_used_again_is_none(folder):
    (folder / RECORD).parent.mkdir(parents=True)
    record = {"pid": os.getpid(), "began_s": 1.0, "host": "127.0.0.1", "port": 8100}
    (folder / RECORD).write_text(json.dumps(record))

    assert running_viewer(folder) is None
    assert stop_viewer(folder) is None  # and this process goes on


def test_without_its_libraries_the_extra_is_named(folder, monkeypatch, dr, capsys):
    monkeypatch.setattr("drcli.web.viewer_process.importlib.util.find_spec", lambda _: None)
    with pytest.raises(NotAvailable) as missing:
        start_viewer(folder, web(folder))

    assert missing.value.code == 7
    assert "drcli[web]" in missing.value.remedy
    assert dr("start-viewer") == 7
    assert "drcli[web]" in capsys.readouterr().err


def test_a_folder_that_takes_no_files_is_one_sentence(folder, dr, capsys):
    (folder / "data").write_text("")

    assert dr("start-viewer") == 3
    assert "cannot be used" in capsys.readouterr().err


def test_a_console_that_does_not_start_says_what_its_log_says(folder, monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nowhere")

    with pytest.raises(SettingsError, match="does not start; the last line of its log") as failed:
        start_viewer(folder, web(folder))

    assert str(log_path(folder)) in failed.value.remedy
    assert not (folder / RECORD).exists()


def test_the_address_for_other_machines_is_one_that_they_can_use(folder):
    record = viewer_process.ViewerRecord(1, 0.0, "0.0.0.0", 8100, "a/token")
    report = viewer_process.report_of(record, started=True)

    assert report.needs_token
    assert "0.0.0.0" not in report.url
    assert report.url.endswith("/enter?token=a%2Ftoken")
    other = viewer_process.ViewerRecord(1, 0.0, "fe80::1", 8100, "t")
    assert viewer_process.report_of(other, started=True).url.startswith("http://[fe80::1]:8100/")
