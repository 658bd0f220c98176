"""`dr summary` as its caller meets it."""

import io
import json
import subprocess
import threading

import pytest
from rich.console import Console

from drcli.base.errors import StorageError
from drcli.bucket.endpoint import Endpoint
from drcli.cli.show import drawn
from drcli.run import summary
from drcli.run.summary import BucketState, Running, Summary
from own_run import own_run


@pytest.fixture
def report():
    """A page on which everything is long."""
    return Summary(
        folder="/home/somebody/racing",
        experiment="wide-turns",
        branch="main",
        run_id=3,
        prefix="team/a-model-with-a-name-that-is-longer-than-most-names-would-ever-be-17",
        race_type="OBJECT_AVOIDANCE",
        world="2022_reinvent_champ_ccw",
        car="FastCar",
        workers=4,
        bucket=BucketState(
            "remote", "bucket", "http://192.168.1.5:9000", "answers", "", "9_Step-17.ckpt", True
        ),
        running=[
            Running("training", 3, "s3://bucket/team/model-17", "reinvent_base", 0.0, 4242),
            Running("evaluation", 0, "s3://bucket/team/model-16", "reinvent_base", 0.0, 4243),
        ],
        versions={"python": "3.12.1", "drcli": "0.1.0", "torch": "2.13.0+cpu", "mujoco": None},
        gpus=["NVIDIA H200"],
        gpu_usable=False,
    )


def shown(report, width):
    screen = Console(width=width, color_system=None, file=io.StringIO())
    with screen.capture() as captured:
        screen.print(drawn(report))
    return captured.get().splitlines()


@pytest.mark.parametrize("width", [80, 160])
def test_a_page_fits_the_terminal_and_tells_everything(report, width):
    lines = shown(report, width)

    text = " ".join(" ".join(lines).split())
    assert max(len(line.rstrip()) for line in lines) <= width
    for word in ("wide-turns", "main", "OBJECT_AVOIDANCE", "4 workers", "answers", "FastCar"):
        assert word in text
    assert "is trained up to 9_Step-17.ckpt" in text
    assert "run 3, s3://bucket/team/model-17 on reinvent_base" in text
    assert "NVIDIA H200, which the installed torch cannot use" in text


def test_a_new_folder_is_described_without_starting_a_server(dr, working_folder, capsys):
    code = dr("summary", "--json")

    page = json.loads(capsys.readouterr().out)
    assert code == 0
    assert (page["prefix"], page["world"], page["workers"]) == ("model", "reinvent_base", 2)
    assert page["running"] == []
    assert page["bucket"]["state"] == "stopped"
    assert page["bucket"]["endpoint"] is None
    assert page["bucket"]["model"] is False
    assert not (working_folder / "data").exists()


def test_a_stopped_servers_checkpoints_are_found_on_the_disk(dr, working_folder, capsys):
    folder = working_folder / "data" / "s3" / "bucket" / "model" / "model"
    folder.mkdir(parents=True)
    for name in ("2_Step-900.ckpt.json", "10_Step-4000.ckpt.json", "model_metadata.json"):
        (folder / name).touch()

    dr("summary", "--json")

    bucket = json.loads(capsys.readouterr().out)["bucket"]
    assert (bucket["model"], bucket["checkpoint"]) == (True, "10_Step-4000.ckpt")


def test_runs_of_all_numbers_are_shown(dr, working_folder, capsys):
    for run_id in (0, 2):
        own_run(run_id=run_id, prefix=f"model-{run_id}").write(
            working_folder / "data" / "runs" / str(run_id)
        )

    dr("summary", "--json")

    running = json.loads(capsys.readouterr().out)["running"]
    assert [(r["kind"], r["run_id"]) for r in running] == [("training", 0), ("training", 2)]


def test_a_bucket_that_fails_is_shown_with_its_reason(dr, working_folder, monkeypatch, capsys):
    def refuse(*_):
        raise StorageError("The keys are wrong.", remedy="Correct them.")

    monkeypatch.setattr(summary.server, "last_known", lambda *_: Endpoint("http://far:9000", pid=1))
    monkeypatch.setattr(summary, "open_running_bucket", refuse)

    code = dr("summary")

    printed = capsys.readouterr().out
    assert code == 0
    assert "The keys are wrong." in printed
    assert "http://far:9000" in printed


def test_a_bucket_that_never_answers_is_not_waited_for(dr, working_folder, monkeypatch, capsys):
    over = threading.Event()
    monkeypatch.setattr(summary.server, "last_known", lambda *_: Endpoint("http://far:9000", pid=1))
    monkeypatch.setattr(summary, "open_running_bucket", lambda *_: over.wait(60) and None)
    monkeypatch.setattr(summary, "BUCKET_PATIENCE_S", 0.0)

    code = dr("summary", "--json")
    over.set()

    bucket = json.loads(capsys.readouterr().out)["bucket"]
    assert code == 0
    assert (bucket["state"], bucket["reason"]) == ("silent", "no answer within 0 s")


def test_the_branch_of_a_git_folder_is_named(dr, working_folder, capsys):
    subprocess.run(["git", "init", "-q", "-b", "wide", str(working_folder)], check=True)

    dr("summary", "--json")

    assert json.loads(capsys.readouterr().out)["branch"] == "wide"
