"""What a complete training does at its end, once, on whichever machine."""

from dataclasses import dataclass

import pytest

from drcli.run.command_process import CommandEnd
from drcli.run.end_of_training import EndOfTraining, import_name
from drcli.run.outcome import INTERRUPTED, Ending
from unwatched import Commands, ending, entries, job_of, running

UPLOADED = CommandEnd(0, {"target": "s3://uploads/team/model"}, seconds=2.0)
IMPORTED = CommandEnd(0, {"site": "deepracer.example.com", "model_id": "abc"}, seconds=60.0)
REFUSED = CommandEnd(3, reason="It refused the model.")
DROA = "DR_DROA_URL=https://deepracer.example.com"


@dataclass(frozen=True)
class Continued(Ending):
    """The end of a start that only completes what an earlier one has left over."""

    only: tuple[str, ...] = ()


def begun(folder, *lines, ends=()):
    job = job_of(folder, *lines)
    commands = Commands(*ends)
    run = running(job)
    duty = EndOfTraining(run, start=commands)
    duty.start()
    return duty, commands, run


def test_the_best_checkpoint_is_uploaded_and_imported_if_wanted(tmp_path):
    lines = "DR_UPLOAD_MODEL_ON_COMPLETION=True", DROA
    duty, commands, run = begun(tmp_path, *lines, ends=[UPLOADED, IMPORTED])
    end = ending()
    assert duty.pending(end) == ["upload", "import"]

    duty.finish(end)

    assert duty.pending(end) == []
    assert [command.arguments[0] for command in commands.started] == [
        "upload-model",
        "droa-import-model",
    ]
    imports = commands.started[1].arguments
    assert {"--once", "--best"} <= set(imports)
    assert imports[imports.index("--model-name") + 1] == "team-model"
    assert [kind for kind, _ in entries(run)] == ["upload", "upload"]


@pytest.mark.parametrize("code", [143, 130, 6, INTERRUPTED])
def test_only_a_complete_training_has_an_end_to_work_on(tmp_path, code):
    duty, commands, _ = begun(tmp_path, "DR_UPLOAD_MODEL_ON_COMPLETION=True", DROA)

    duty.finish(ending(code))

    assert commands.started == []
    assert duty.pending(ending(code)) == []


def test_what_fails_stays_for_a_successor(tmp_path):
    lines = "DR_UPLOAD_MODEL_ON_COMPLETION=True", DROA
    duty, _, run = begun(tmp_path, *lines, ends=[UPLOADED, REFUSED])

    duty.finish(ending())

    assert duty.pending(ending()) == ["import"]
    kind, text = entries(run)[-1]
    assert kind == "fault"
    assert "It refused the model." in text
    assert "--model-prefix team/model --model-name team-model --best --once`" in text


def test_a_successor_does_what_was_left_over_and_no_more(tmp_path):
    lines = "DR_UPLOAD_MODEL_ON_COMPLETION=True", DROA
    duty, commands, _ = begun(tmp_path, *lines, ends=[IMPORTED])
    end = ending()
    rest = Continued(end.outcome, None, lambda: False, only=("import", "unknown"))

    duty.finish(rest)

    assert commands.names == ["droa-import-model --model-prefix"]
    assert duty.pending(rest) == []


def test_without_time_everything_is_left(tmp_path):
    duty, commands, _ = begun(tmp_path, "DR_UPLOAD_MODEL_ON_COMPLETION=True")

    duty.finish(ending(0, 0.0))

    assert commands.started == []
    assert duty.pending(ending()) == ["upload"]


def test_nobody_without_deepracer_on_aws_is_bothered(tmp_path, logged):
    duty, commands, _ = begun(tmp_path)
    duty.finish(ending())

    assert commands.started == []
    assert "DEEPRACER" not in logged().upper()
    assert "IMPORT" not in logged()


def test_nothing_is_imported_without_an_address(tmp_path):
    duty, commands, _ = begun(tmp_path, "DR_IMPORT_MODEL_ON_COMPLETION=True")
    duty.finish(ending())

    assert commands.started == []


@pytest.mark.parametrize("wanted", ["DR_REGULAR_UPLOAD=60", "DR_UPLOAD_BEST_MODEL=True"])
def test_regular_uploads_end_with_the_best_checkpoint_or_say_that_they_did_not(tmp_path, wanted):
    duty, commands, _ = begun(tmp_path, wanted, ends=[REFUSED])

    duty.finish(ending())

    assert commands.names == ["upload-model -b"]
    assert duty.end_result().code == 10
    assert "It refused the model." in duty.end_result().message


def test_no_import_if_it_is_switched_off(tmp_path):
    duty, commands, _ = begun(tmp_path, "DR_IMPORT_MODEL_ON_COMPLETION=False", DROA)
    duty.finish(ending())

    assert commands.started == []


def test_a_missing_password_is_told_at_the_start(tmp_path, logged, monkeypatch):
    monkeypatch.delenv("DR_DROA_PASSWORD", raising=False)
    begun(tmp_path, DROA)
    assert "DR_DROA_PASSWORD" in logged()


def test_a_name_that_cannot_be_imported_is_made_one():
    assert import_name("training/reinvent_base/model_1") == "training-reinvent-base-model-1"
    assert len(import_name("a" * 200)) == 64
    assert import_name("___") == "model"
