"""The commands that move models and files, as their caller meets them."""

import json
import os

import pytest

from drcli.model import keys

from .conftest import driven, put_model

TARGET = "team/model-1"


@pytest.fixture
def answer(monkeypatch):
    """Lets a line wait on standard input, as `echo` does."""
    readers = []

    def pipe(text):
        reader, writer = os.pipe()
        os.write(writer, text.encode())
        os.close(writer)
        readers.append(os.fdopen(reader))
        monkeypatch.setattr("sys.stdin", readers[-1])

    yield pipe
    for reader in readers:
        reader.close()


def report(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_upload_prints_the_line_that_scripts_look_for_on_stdout(dr, mover, capsys):
    code = dr("upload-model", "-bf")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.splitlines()[0] == "Best checkpoint: 3"
    assert printed.out.splitlines()[1].startswith(
        "Uploaded 3_Step-300.ckpt of s3://bucket/team/model to s3://uploads/team/model-1: 12 files"
    )
    assert "Next:" in printed.err
    assert driven(mover.there, TARGET) == "weights 3 of design a"


@pytest.mark.parametrize("no", ["n\n", "\n", ""])
def test_upload_shows_the_checkpoint_before_it_asks_and_a_no_copies_nothing(
    dr, mover, answer, capsys, no
):
    answer(no)

    code = dr("upload-model", "-b")

    printed = capsys.readouterr()
    assert code == 1
    assert printed.out == "Best checkpoint: 3\n"
    assert "Are you sure? [y/N]" in printed.err
    assert "Aborting." in printed.err
    assert mover.there.list("") == []


def test_a_yes_uploads(dr, mover, answer):
    answer("y\n")

    assert dr("upload-model", "-b") == 0
    assert driven(mover.there, TARGET) == "weights 3 of design a"


def test_upload_as_json_is_one_object(dr, mover, capsys):
    code = dr("upload-model", "-f", "-c", "3", "--json")

    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert code == 0
    assert "Chosen checkpoint: 3" in printed.err
    assert (found["checkpoint"], found["choice"]) == ("3_Step-300.ckpt", "3")
    assert found["target"] == "s3://uploads/team/model-1"
    assert "model/deepracer_checkpoints.json" in found["copied"]


def test_a_dry_run_asks_nothing_and_says_what_it_is(dr, mover, capsys):
    code = dr("upload-model", "-d", "-w")

    printed = capsys.readouterr()
    assert code == 0
    assert "*** DRYRUN MODE ***" in printed.err
    assert "Would upload 5_Step-500.ckpt" in printed.out
    assert mover.there.list("") == []


def test_1_raises_the_number_and_uploads_there(dr, mover, capsys):
    code = dr("upload-model", "-1f")

    assert code == 0
    assert "Incrementing model from team/model-1 to team/model-2" in capsys.readouterr().err
    assert driven(mover.there, "team/model-2") == "weights 5 of design a"
    assert mover.settings().upload_s3_prefix == "team/model-2"


def test_1_announces_nothing_where_no_upload_can_be_made(dr, mover, capsys, monkeypatch):
    monkeypatch.setenv("DR_UPLOAD_S3_BUCKET", "not-defined")

    code = dr("upload-model", "-b", "-f", "-1")

    said = capsys.readouterr().err
    assert code == 3
    assert "No upload bucket defined." in said
    assert "Incrementing" not in said


@pytest.mark.parametrize("options", [["-1"], ["-1", "-d"]])
def test_1_changes_no_name_where_nothing_is_uploaded(dr, mover, answer, options):
    answer("n\n")

    dr("upload-model", *options)

    assert mover.settings().upload_s3_prefix == "team/model-1"


@pytest.mark.parametrize(
    ("options", "words"),
    [(["-b", "-c", "3"], "-b and -c"), (["-1", "-p", "x"], "-1 changes"), (["-c", "-1"], "-c")],
)
def test_upload_options_that_contradict_each_other_exit_2(dr, mover, capsys, options, words):
    assert dr("upload-model", "-f", *options) == 2
    assert words in capsys.readouterr().err


def test_a_refused_upload_exits_3(dr, mover, capsys):
    (mover.folder / "system.env").write_text("")

    assert dr("upload-model", "-f") == 3
    assert "No upload bucket defined. Exiting." in capsys.readouterr().err


def test_increment_says_what_it_edits(dr, mover, capsys):
    code = dr("increment-upload-model", "-f")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == "The next upload goes to team/model-2.\n"
    assert f"Configuration file {mover.folder / 'run.env'} will be updated.\n" in printed.err
    assert "Incrementing model from team/model-1 to team/model-2\n" in printed.err
    assert "Done.\n" in printed.err


def test_increment_as_json_tells_file_and_names(dr, mover, capsys):
    dr("increment-upload-model", "-f", "-d", "_", "--json")

    found = report(capsys)
    assert (found["before"], found["after"]) == ("team/model-1", "team/model-1_1")
    assert found["backup"] == str(mover.folder / "run.env.bak")


def test_increment_asks_before_it_wipes(dr, mover, answer, capsys):
    put_model(mover.there, "team/model-2")
    answer("n\n")

    code = dr("increment-upload-model", "-w")

    assert code == 1
    assert "files at s3://uploads/team/model-2 will be deleted." in capsys.readouterr().err
    assert mover.there.list("team/model-2/")
    assert mover.settings().upload_s3_prefix == "team/model-1"


@pytest.mark.parametrize("delimiter", ["", "1"])
def test_a_delimiter_that_cannot_be_told_from_the_number_exits_2(dr, mover, delimiter):
    assert dr("increment-upload-model", "-f", "-d", delimiter) == 2


def test_set_upload_model_writes_the_name_and_says_so(dr, mover, capsys):
    code = dr("set-upload-model", "team/fast-7")

    assert code == 0
    assert capsys.readouterr().out.startswith("The next upload goes to s3://uploads/team/fast-7")
    assert mover.settings().upload_s3_prefix == "team/fast-7"


def test_set_upload_model_as_json(dr, mover, capsys):
    dr("set-upload-model", "team/fast-7", "--json")

    found = report(capsys)
    assert (found["before"], found["after"]) == ("team/model-1", "team/fast-7")


def test_set_upload_model_refuses_what_no_model_can_be_called(dr, mover, capsys):
    assert dr("set-upload-model", "fast car") == 3
    assert "DR_UPLOAD_S3_PREFIX=fast car" in capsys.readouterr().err


def test_download_fetches_and_says_how_to_go_on(dr, mover, capsys):
    put_model(mover.there, "theirs", numbers=(2,))
    mover.use_as_source()

    code = dr("download-model", "-f", "-s", "s3://uploads/theirs", "-t", "mine")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.startswith("Downloaded s3://uploads/theirs to s3://bucket/mine: ")
    assert "DR_LOCAL_S3_MODEL_PREFIX=mine dr-evaluate" in printed.err
    assert driven(mover.here, "mine") == "weights 2 of design a"


def test_a_model_without_a_checkpoint_is_fetched_and_nobody_is_sent_to_drive_it(dr, mover, capsys):
    put_model(mover.there, "theirs", numbers=(2,))
    model = mover.there.list("theirs/model/")
    mover.there.delete([info.key for info in model if "metadata" not in info.key])
    mover.here.put("mine/note.txt", b"?")
    mover.use_as_source()

    code = dr("download-model", "-f", "-s", "s3://uploads/theirs", "-t", "mine")

    printed = capsys.readouterr()
    assert code == 0
    assert "It has no checkpoint yet" in printed.out
    assert "dr-evaluate" not in printed.err
    assert "is not empty: 1 file." in printed.err
    assert "Not part of it: 1 file at the target; -w deletes them." in printed.out


def test_download_as_json(dr, mover, capsys):
    put_model(mover.there, "theirs", numbers=(2,))
    mover.use_as_source()

    dr("download-model", "-f", "-s", "s3://uploads/theirs", "-t", "mine", "--json")

    found = report(capsys)
    assert (found["target"], found["checkpoint"]) == ("s3://bucket/mine", "2_Step-200.ckpt")


def test_a_no_downloads_nothing(dr, mover, answer, capsys):
    put_model(mover.there, "theirs")
    mover.use_as_source()
    answer("n\n")

    code = dr("download-model", "-s", "s3://uploads/theirs", "-t", "mine")

    assert code == 1
    assert "Aborting." in capsys.readouterr().err
    assert mover.here.list("mine/") == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "No source URL to download model from."),
        (["-s", "s3://uploads/theirs"], "No target prefix defined. Exiting."),
    ],
)
def test_download_needs_a_source_and_a_target(dr, mover, capsys, options, words):
    assert dr("download-model", *options) == 2
    assert words in capsys.readouterr().err


def test_models_are_listed_with_their_checkpoints(dr, mover, capsys):
    code = dr("list-models")

    printed = capsys.readouterr().out
    assert code == 0
    assert printed.splitlines()[0] == "s3://bucket"
    assert "3 (score 90)" in printed
    assert "5 (score 50)" in printed
    assert all(len(line) <= 80 for line in printed.splitlines())


@pytest.mark.parametrize("command", [["list-models", "--upload"], ["list-aws-models"]])
def test_models_of_the_bucket_of_uploads_are_listed(dr, mover, capsys, command):
    put_model(mover.there, "theirs")

    dr(*command, "the*", "--json")

    found = report(capsys)
    assert (found["bucket"], found["pattern"]) == ("uploads", "the*")
    assert [model["prefix"] for model in found["models"]] == ["theirs"]
    assert found["models"][0]["best"]["name"] == "3_Step-300.ckpt"


@pytest.mark.parametrize(
    ("command", "remedy"),
    [
        (["upload-model", "-f"], "or upload into the local bucket with -L."),
        (["list-models", "--upload"], "or list the local bucket with `dr-list-models`."),
        (["list-aws-models"], "or list the local bucket with `dr-list-models`."),
        (["increment-upload-model", "-fw"], "Set DR_UPLOAD_S3_BUCKET in system.env.\n"),
    ],
)
def test_without_a_bucket_of_uploads_each_command_says_what_it_can_do(
    dr, mover, capsys, command, remedy
):
    (mover.folder / "system.env").write_text("")

    assert dr(*command) == 3
    assert remedy in capsys.readouterr().err


def test_a_pattern_that_fits_nothing_says_so(dr, mover, capsys):
    assert dr("list-models", "nothing") == 0
    assert capsys.readouterr().out == "There is no model in s3://bucket that matches nothing.\n"


def test_custom_files_go_up_and_come_back(dr, mover, capsys):
    custom = mover.folder / "custom_files"
    custom.mkdir()
    (custom / "run.env").write_text("A=1")

    up = dr("upload-custom-files")
    printed = capsys.readouterr()
    (custom / "run.env").unlink()
    down = dr("download-custom-files", "--json")

    assert (up, down) == (0, 0)
    assert "Uploading files to s3://bucket/custom_files" in printed.err
    assert printed.out == "run.env\n1 file copied to s3://bucket/custom_files.\n"
    assert report(capsys)["copied"] == ["run.env"]
    assert (custom / "run.env").read_text() == "A=1"


def test_a_name_that_leads_out_of_the_folder_is_warned_of(dr, mover, capsys):
    mover.here.put("custom_files/../run.env", b"evil")

    code = dr("download-custom-files")

    assert code == 0
    assert "leads out of" in capsys.readouterr().err


def test_an_upload_over_a_model_in_use_keeps_the_index_whole(dr, mover):
    dr("upload-model", "-f")
    dr("upload-model", "-fbw")

    assert mover.there.get(keys.coach_checkpoint(TARGET)) == b"3_Step-300.ckpt"
    assert driven(mover.there, TARGET) == "weights 3 of design a"
