"""`dr history` as its caller meets it, on a bucket whose server does not run."""

import csv
import hashlib
import io
import json

import pytest

from drcli.model import keys
from drcli.records.training_record import TrainingFiles
from past_trainings import child, training

REWARDS = ("def reward_function(params):\n    return 1.0\n", "def reward_function(params):\n")


def sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
def history(working_folder):
    """Two trainings: of a model that is gone, and of its child, which has another reward."""
    folder = working_folder / "data" / "s3" / "bucket"

    def put(key, data):
        path = folder / key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    files = {"reward_function.py": sha256(REWARDS[0])}
    first = training(0x1AB, "team/one", start={"files": files, "seed": 1_350_147_306})
    other = child(
        0x2FF,
        "team/two",
        first,
        world="Vegas_track",
        state="failed",
        results={"best_lap_s": 12.5},
        start={"files": {"reward_function.py": sha256(REWARDS[1])}},
        hyperparameters={"lr": 0.0005, "batch_size": 64},
    )
    for record, text in zip((first, other), REWARDS, strict=True):
        put(keys.training_record(record.prefix, record.id), record.encode())
        files = TrainingFiles({sha256(text): text})
        put(keys.training_files(record.prefix, record.id), files.encode())
    put(keys.coach_checkpoint("team/two"), b"1_Step-100.ckpt")
    return put


def printed(capsys):
    return capsys.readouterr().out


def listed(capsys):
    return [entry["id"] for entry in json.loads(printed(capsys))["trainings"]]


def test_alone_it_lists_all_trainings_the_newest_last(dr, history, capsys):
    assert dr("history") == 0

    lines = printed(capsys).splitlines()
    assert lines[0] == "s3://bucket"
    assert lines[2].split()[:3] == ["000001ab", "team/one", "(gone)"]
    assert lines[3].split()[:2] == ["000002ff", "team/two"]
    assert "12.50 s" in lines[3]
    assert lines[-1] == "2 trainings."


@pytest.mark.parametrize(
    ("arguments", "ids"),
    [
        (["one"], ["000001ab"]),
        (["list", "team/*"], ["000001ab", "000002ff"]),
        (["--world", "vegas*"], ["000002ff"]),
        (["--state", "failed"], ["000002ff"]),
        (["--since", "2020-01-01", "--until", "2021-01-01"], []),
        (["--where", "lr<0.001"], ["000002ff"]),
        (["--where", "lr<0.001", "--where", "batch_size=1"], []),
        (["--sort", "lap", "-n", "1"], ["000002ff"]),
        (["--sort", "hours", "--limit", "1"], ["000002ff"]),
    ],
)
def test_trainings_are_chosen(dr, history, capsys, arguments, ids):
    assert dr("history", *arguments, "--json") == 0

    assert listed(capsys) == ids


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--state", "done"], 3, "--state done is no state"),
        (["--since", "soon"], 3, "neither a date nor an age"),
        (["--where", "x"], 3, "is no comparison"),
        (["--sort", "beauty"], 2, "beauty"),
        (["show", "nothing"], 3, "There is no training nothing"),
        (["compare", "team/one"], 2, "OTHER"),
        (["forget", "nothing", "-f"], 3, "There is no training nothing"),
    ],
)
def test_what_makes_no_sense_is_refused(dr, history, capsys, arguments, code, said):
    assert dr("history", *arguments) == code

    assert said in capsys.readouterr().err


def test_a_list_without_results_says_what_there_is(dr, history, capsys):
    dr("history", "nothing")

    assert "No training in s3://bucket fits; it has 2." in printed(capsys)


def test_before_the_first_training_it_says_how_to_start_one(dr, working_folder, capsys):
    assert dr("history") == 1

    assert "dr-start-training" in capsys.readouterr().err


def test_a_damaged_record_is_a_warning(dr, history, capsys):
    history(keys.training_record("bad", "0000000a"), b"{half")

    assert dr("history") == 0

    said = capsys.readouterr()
    assert "2 trainings." in said.out
    assert "bad/0000000a.json is damaged" in said.err


def test_a_training_is_shown_whole(dr, history, capsys):
    assert dr("history", "show", "team/two") == 0

    out = " ".join(printed(capsys).split())
    assert "Training 000002ff of team/two (failed)" in out
    assert "began with team/one, 5_Step-500.ckpt (training 000001ab)" in out
    assert "lr 0.0005" in out
    assert "Xeon, 2 cores, drcli 0.2.0" in out


def test_the_files_of_a_deleted_model_are_given_back(dr, history, capsys, working_folder):
    assert dr("history", "show", "000001ab", "--save", "old") == 0
    assert (working_folder / "old" / "reward_function.py").read_text() == REWARDS[0]

    assert dr("history", "show", "000001ab", "--save", "old") == 3
    assert "old/reward_function.py exists" in capsys.readouterr().err


def test_two_trainings_are_compared(dr, history, capsys):
    assert dr("history", "compare", "team/one", "team/two") == 0

    out = printed(capsys)
    assert "lr 0.001 -> 0.0005" in out
    assert "-    return 1.0" in out
    assert "pretrained model - -> team/one" in out
    assert "seed 1350147306 -> 767" in out  # as `--seed` takes it


def test_the_family_is_shown_as_a_tree(dr, history, capsys):
    assert dr("history", "tree", "team/one") == 0

    out = printed(capsys).splitlines()
    assert out[1].startswith("team/one  000001ab, 2028-01-19, reinvent_base, best lap 15.00 s")
    assert out[2].startswith("  team/two  000002ff")
    assert out[3].strip() == "reward_function.py; lr 0.001 -> 0.0005"


def test_a_table_goes_to_a_file_or_to_standard_output(dr, history, capsys, working_folder):
    assert dr("history", "--csv", "trainings.csv") == 0
    assert "2 trainings." in printed(capsys)
    rows = list(csv.DictReader(io.StringIO((working_folder / "trainings.csv").read_text())))
    assert [row["model"] for row in rows] == ["team/one", "team/two"]

    assert dr("history", "two", "--csv", "-") == 0
    [row] = csv.DictReader(io.StringIO(printed(capsys)))
    assert row["lr"] == "0.0005"


def test_a_table_that_cannot_be_written_is_told(dr, history, capsys):
    assert dr("history", "--csv", "nowhere/trainings.csv") == 3

    assert "nowhere/trainings.csv" in capsys.readouterr().err


def test_nothing_from_a_record_controls_the_terminal(dr, history, capsys):
    bad = training(9, "team/bad", world="\x1b[31mred\n", description="\x1b]0;title\x07")
    history(keys.training_record(bad.prefix, bad.id), bad.encode())

    for arguments in ([], ["show", "team/bad"], ["tree"], ["compare", "team/bad", "team/one"]):
        dr("history", *arguments)

    assert not set(printed(capsys)) & {"\x1b", "\x07"}


def test_a_record_is_forgotten_after_a_question(dr, history, capsys, monkeypatch, working_folder):
    from drcli.bucket.connect import FolderBucket

    deleted = []
    bucket = FolderBucket(working_folder / "data" / "s3" / "bucket")
    monkeypatch.setattr(bucket, "delete", deleted.extend)
    monkeypatch.setattr("drcli.bucket.connect.open_bucket", lambda *_, **__: bucket)

    assert dr("history", "forget", "team/one", "-d") == 0
    assert deleted == []
    assert dr("history", "forget", "000001ab", "-f", "--json") == 0

    assert sorted(deleted) == [
        "training-records/team/one/000001ab.files.json",
        "training-records/team/one/000001ab.json",
    ]
