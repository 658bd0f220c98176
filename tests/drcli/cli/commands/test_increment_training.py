"""`dr increment-training` as its caller meets it."""

import io
import json
import shlex

import pytest

from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket


@pytest.fixture
def bucket(working_folder, monkeypatch):
    """A bucket that holds a model with one checkpoint, where run.env expects it."""
    bucket = MemoryBucket()
    CheckpointStore(ModelStore(bucket, "model")).save(4, 900, b"weights")
    monkeypatch.setattr("drcli.run.increment.open_bucket", lambda *_, **__: bucket)
    return bucket


@pytest.fixture
def answer(monkeypatch):
    def type_in(text):
        monkeypatch.setattr("sys.stdin", io.StringIO(text))

    return type_in


def test_it_says_what_will_be_edited_and_what_comes_next(dr, bucket, working_folder, capsys):
    code = dr("increment-training", "-f")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == (
        "model-1 starts with the weights of model (last checkpoint 4_Step-900.ckpt).\n"
    )
    assert f"Configuration file {working_folder / 'run.env'} will be updated.\n" in printed.err
    assert "Incrementing model from model to model-1\n" in printed.err
    assert "Done.\n" in printed.err
    assert printed.err.index("dr-start-training") > printed.err.index("Next:")


def test_the_way_back_can_be_pasted_where_a_folder_has_a_blank_in_its_name(
    dr, bucket, working_folder, monkeypatch, capsys
):
    folder = working_folder / "my racer"
    folder.mkdir()
    for name in ("run.env", "system.env"):
        (working_folder / name).rename(folder / name)
    monkeypatch.chdir(folder)

    dr("increment-training", "-f")

    way_back = next(line for line in capsys.readouterr().err.splitlines() if " cp " in line)
    words = shlex.split(way_back.partition("#")[0])
    assert words == ["cp", str(folder / "run.env.bak"), str(folder / "run.env")]


@pytest.mark.parametrize("yes", ["y\n", "yes\n", "Y\n"])
def test_a_yes_makes_the_edit(dr, bucket, working_folder, answer, capsys, yes):
    answer(yes)

    code = dr("increment-training")

    assert code == 0
    assert "Are you sure? [y/N]" in capsys.readouterr().err
    assert "DR_LOCAL_S3_MODEL_PREFIX=model-1\n" in (working_folder / "run.env").read_text()


@pytest.mark.parametrize("no", ["n\n", "\n", "", "yess\n"])
def test_anything_but_a_yes_changes_nothing(dr, bucket, working_folder, answer, capsys, no):
    before = (working_folder / "run.env").read_bytes()
    answer(no)

    code = dr("increment-training")

    assert code == 1
    assert "Aborting. Nothing was changed" in capsys.readouterr().err
    assert (working_folder / "run.env").read_bytes() == before
    assert not (working_folder / "run.env.bak").exists()


def test_a_wipe_is_a_question_of_its_own(dr, bucket, working_folder, answer, capsys):
    bucket.put("model-1/model/x", b"")
    answer("y\nn\n")

    code = dr("increment-training", "-w")

    assert code == 1
    assert "Delete everything at s3://bucket/model-1? [y/N]" in capsys.readouterr().err
    assert bucket.exists("model-1/model/x")


def test_json_is_the_only_thing_on_stdout(dr, bucket, working_folder, capsys):
    dr("increment-training", "-f", "-p", "team/next", "--json")

    step = json.loads(capsys.readouterr().out)
    assert (step["before"], step["after"], step["wipes"]) == ("model", "team/next", False)
    assert step["file"] == str(working_folder / "run.env")
    assert step["backup"] == str(working_folder / "run.env.bak")
    assert step["pretrained"]["name"] == "4_Step-900.ckpt"


def test_the_delimiter_stands_before_the_first_number(dr, bucket, working_folder):
    dr("increment-training", "-f", "-d", "_v")

    assert "DR_LOCAL_S3_MODEL_PREFIX=model_v1\n" in (working_folder / "run.env").read_text()


@pytest.mark.parametrize("delimiter", ["", "7"])
def test_a_delimiter_that_cannot_be_told_from_the_number_exits_2(dr, bucket, capsys, delimiter):
    assert dr("increment-training", "-f", "-d", delimiter) == 2
    assert "as - or _" in capsys.readouterr().err


def test_a_refusal_exits_3_and_leaves_the_file_alone(dr, bucket, working_folder, capsys):
    bucket.put("model-1/model/x", b"")
    before = (working_folder / "run.env").read_bytes()

    code = dr("increment-training", "-f")

    assert code == 3
    assert "Choose another name with -p; -w would delete that model." in capsys.readouterr().err
    assert (working_folder / "run.env").read_bytes() == before
