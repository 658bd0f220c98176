"""What `dr-export tf-checkpoint` leaves at its target, and what it refuses."""

import json

import numpy as np
import pytest

from drcli.convert.imported_policy import read_reference_checkpoint
from drcli.model import keys
from trained_model import put_trained_model

MODEL = "team/model"
FILES = [
    "ip/hyperparameters.json",
    "model/.coach_checkpoint",
    "model/5_Step-500.ckpt.data-00000-of-00001",
    "model/5_Step-500.ckpt.index",
    "model/5_Step-500.ckpt.meta",
    "model/checkpoint",
    "model/deepracer_checkpoints.json",
    "model/model_5.pb",
    "model/model_metadata.json",
    "reward_function.py",
]


def files_of(folder):
    return sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    )


def test_the_folder_is_a_model_of_the_reference(dr, exporter, tmp_path, capsys):
    model = put_trained_model(exporter.here, MODEL)
    folder = tmp_path / "out"

    code = dr("export", "tf-checkpoint", "-c", "last", "--out", str(folder))

    printed = capsys.readouterr().out
    assert code == 0
    assert files_of(folder) == FILES
    assert (folder / "model/.coach_checkpoint").read_text() == "5_Step-500.ckpt"
    assert (folder / "model/checkpoint").read_text().splitlines() == [
        'model_checkpoint_path: "5_Step-500.ckpt"',
        'all_model_checkpoint_paths: "5_Step-500.ckpt"',
    ]
    index = json.loads((folder / "model/deepracer_checkpoints.json").read_text())
    assert index["last_checkpoint"]["name"] == index["best_checkpoint"]["name"] == "5_Step-500.ckpt"
    found = read_reference_checkpoint(
        *(
            (folder / f"model/5_Step-500.ckpt{end}").read_bytes()
            for end in (".index", ".data-00000-of-00001")
        ),
        "5_Step-500.ckpt",
    )
    np.testing.assert_array_equal(
        found.weights["policy_head.weight"], model.policy_head.weight.detach().numpy()
    )
    assert "Verified: The files were read back, and the 38 variables" in printed
    assert "Not verified: The reference simulator itself" in printed


@pytest.mark.usefixtures("small_checkpoints")
@pytest.mark.parametrize(("option", "name"), [("-b", "3_Step-300"), ("-c3", "3_Step-300")])
def test_a_checkpoint_can_be_chosen(dr, exporter, tmp_path, option, name):
    put_trained_model(exporter.here, "other")

    code = dr("export", "tf-checkpoint", option, "-p", "other", "--out", str(tmp_path / "out"))

    assert code == 0
    assert (tmp_path / "out/model/.coach_checkpoint").read_text() == f"{name}.ckpt"
    assert (tmp_path / "out/model/model_3.pb").exists()


@pytest.mark.usefixtures("small_checkpoints")
def test_without_out_the_folder_is_named_after_the_model(dr, exporter):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    assert dr("export", "tf-checkpoint") == 0

    assert files_of(exporter.folder / f"{MODEL.replace('/', '-')}-tf-checkpoint") == FILES


@pytest.mark.usefixtures("small_checkpoints")
def test_a_bucket_gets_the_pointers_last(dr, exporter, names, capsys):
    put_trained_model(exporter.here, MODEL, numbers=(5,))
    written = []
    put = exporter.there.put
    exporter.there.put = lambda key, *rest, **more: (written.append(key), put(key, *rest, **more))

    code = dr("export", "tf-checkpoint", "--out", "s3://uploads/a/b", "--json")

    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0
    assert names(exporter.there, "a/b") == report["files"] == FILES
    assert report["target"] == "s3://uploads/a/b"
    assert [key.removeprefix("a/b/") for key in written[-2:]] == [
        "model/.coach_checkpoint",
        "model/deepracer_checkpoints.json",
    ]


@pytest.mark.usefixtures("small_checkpoints")
@pytest.mark.parametrize("out", ["folder", "s3://uploads/a/b"])
def test_files_at_the_target_are_only_replaced_with_f(dr, exporter, names, capsys, out):
    put_trained_model(exporter.here, MODEL)
    if out == "folder":
        assert dr("export", "tf-checkpoint", "--out", out) == 0
    else:
        exporter.there.put("a/b/model/9_Step-9.ckpt.index", b"old")
        exporter.there.put(keys.coach_checkpoint("a/b"), b"9_Step-9.ckpt")

    refused = dr("export", "tf-checkpoint", "--out", out)

    assert refused == 3
    assert "is not empty" in capsys.readouterr().err
    assert dr("export", "tf-checkpoint", "-c", "last", "--out", out, "-f") == 0
    pointer = (
        (exporter.folder / "folder/model/.coach_checkpoint").read_bytes()
        if out == "folder"
        else exporter.there.get(keys.coach_checkpoint("a/b"))
    )
    assert pointer == b"5_Step-500.ckpt"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"neural_network": "COMPACT_CONVOLUTIONAL_NETWORK"}, "COMPACT_CONVOLUTIONAL_NETWORK does"),
        ({"training_algorithm": "sac", "continuous": True}, "training_algorithm=sac"),
        ({"hyperparameters": {"stack_size": 2}}, "stack_size=2"),
    ],
)
def test_what_the_reference_does_not_have_is_refused_and_nothing_written(
    dr, exporter, tmp_path, capsys, changes, reason
):
    put_trained_model(exporter.here, MODEL, numbers=(5,), **changes)

    code = dr("export", "tf-checkpoint", "--out", str(tmp_path / "out"))

    assert code == 3
    assert reason in capsys.readouterr().err
    assert list(tmp_path.glob("**/*.ckpt*")) == []
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("small_checkpoints")
@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ("run.env", "is a file"),
        ("s3://", "is not the address of a model"),
        ("s3://uploads/", "is not the address of a model"),
        ("run.env/below", "cannot be written"),
    ],
)
def test_a_target_that_cannot_be_is_refused(dr, exporter, capsys, out, reason):
    put_trained_model(exporter.here, MODEL, numbers=(5,))

    code = dr("export", "tf-checkpoint", "--out", out)

    said = capsys.readouterr().err
    assert code == 3
    assert reason in said
    assert "Try:" in said


def test_two_choices_are_a_wrong_command_line(dr, exporter, capsys):
    assert dr("export", "tf-checkpoint", "-b", "-c", "3") == 2
    assert "use only one" in capsys.readouterr().err


def test_a_model_of_the_reference_is_exported_as_it_is(dr, exporter, tmp_path):
    put_trained_model(exporter.here, MODEL, numbers=(5,))
    assert dr("export", "tf-checkpoint", "--out", "s3://uploads/a/b") == 0
    for info in exporter.there.list("a/b/"):
        exporter.here.put(info.key, exporter.there.get(info.key))

    assert dr("export", "tf-checkpoint", "-p", "a/b", "--out", str(tmp_path / "out")) == 0

    ends = (".index", ".data-00000-of-00001")
    name = "model/5_Step-500.ckpt"
    before = [exporter.here.get(f"a/b/{name}{end}") for end in ends]
    after = [(tmp_path / "out" / f"{name}{end}").read_bytes() for end in ends]
    old, new = (read_reference_checkpoint(*each, name).weights for each in (before, after))
    assert old.keys() == new.keys()
    assert all(np.array_equal(array, new[key]) for key, array in old.items())
