"""Values are changed where they belong, checked before they are written, and nothing else moves."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from drcli.base.errors import SettingsError
from drcli.config.editing import FilesChanged, set_values, version_of
from drcli.config.settings import catalogue


@pytest.fixture
def files(folder):
    folder.write("system.env", "# this machine\nDR_WORKERS=1  # cores\n")
    folder.write("run.env", "DR_WORLD_NAME=reinvent_base\nDR_CAR_NAME='Fast Car'\n")
    return folder


def edit(folder, environ=None, **wanted):
    return set_values(folder.path, wanted, environ=environ or {})


def content(folder, name="run.env"):
    return (folder.path / name).read_bytes()


def test_a_value_is_changed_where_it_stands(files):
    done = edit(files, DR_WORKERS="3", DR_CAR_NAME="Comet")

    assert content(files, "system.env") == b"# this machine\nDR_WORKERS=3  # cores\n"
    assert content(files) == b"DR_WORLD_NAME=reinvent_base\nDR_CAR_NAME='Comet'\n"
    assert [(c.name, c.before, c.after, c.file) for c in done.changes] == [
        ("DR_WORKERS", "1", "3", "system.env"),
        ("DR_CAR_NAME", "Fast Car", "Comet", "run.env"),
    ]
    assert done.warnings == ()


def test_a_value_that_stands_in_an_unusual_file_is_changed_there(files):
    files.write("run.env", "DR_WORKERS=2\n")
    files.write("system.env", "DR_CLOUD=local\n")

    edit(files, DR_WORKERS="3")

    assert content(files) == b"DR_WORKERS=3\n"
    assert content(files, "system.env") == b"DR_CLOUD=local\n"


@pytest.mark.parametrize(
    ("name", "value", "file"),
    [
        ("DR_AWS_APP_REGION", "eu-west-1", "system.env"),
        ("DR_TORCH_PRECISION", "fp32", "system.env"),
        ("DR_TRAIN_SEED", "4", "run.env"),
        ("DR_UPLOAD_S3_PREFIX", "$DR_LOCAL_S3_MODEL_PREFIX-9", "run.env"),
    ],
)
def test_a_new_value_goes_to_the_file_of_its_kind(files, name, value, file):
    edit(files, **{name: value})

    assert content(files, file).endswith(f"\n{name}={value}\n".encode())


def test_a_missing_file_is_made_where_it_is_needed(files):
    (files.path / "system.env").unlink()

    edit(files, DR_WORKERS="3")

    assert content(files, "system.env") == b"DR_WORKERS=3\n"


def test_the_run_env_of_the_experiment_is_meant(files):
    files.write("system.env", "DR_EXPERIMENT_NAME=first\n")
    files.write("experiments/first/run.env", "DR_TRAIN_SEED=1")
    before = content(files)

    done = edit(files, DR_TRAIN_SEED="2")

    assert content(files, "experiments/first/run.env") == b"DR_TRAIN_SEED=2"
    assert content(files) == before
    assert done.changes[0].file == "experiments/first/run.env"


def test_a_wrong_experiment_can_be_corrected(files):
    files.write("system.env", "DR_EXPERIMENT_NAME=frist\n")
    files.write("experiments/first/run.env", "")

    edit(files, DR_EXPERIMENT_NAME="first")

    assert content(files, "system.env") == b"DR_EXPERIMENT_NAME=first\n"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("DR_WORKERS", "-1", "system.env stays as it was: DR_WORKERS=-1 is below 0"),
        ("DR_RACE_TYPE", "RALLY", "run.env stays as it was: DR_RACE_TYPE=RALLY is not one of"),
        ("DR_CAR_NAME", "$NOBODY", "run.env"),
        (
            "DR_TRAIN_SEED",
            "1\n2",
            "run.env stays as it was: DR_TRAIN_SEED='1.*is not a whole number",
        ),
        ("DR_TRAIN_SEED", "\0", "run.env"),
        ("DR_CLOUD", "remote", "DR_REMOTE_MINIO_URL is empty"),
        ("DR_EXPERIMENT_NAME", "none", "has no experiments/none/run.env"),
    ],
)
def test_a_wrong_value_changes_nothing(files, name, value, words):
    before = content(files), content(files, "system.env")

    with pytest.raises(SettingsError, match=words):
        edit(files, **{name: value, "DR_EVAL_MAX_RESETS": "7"})

    assert (content(files), content(files, "system.env")) == before


def test_an_empty_value_means_not_set(files):
    edit(files, DR_WORKERS="")

    assert content(files, "system.env") == b"# this machine\nDR_WORKERS=  # cores\n"
    assert files.load(content(files)).source("DR_WORKERS") == "default"


@pytest.mark.parametrize("value", ["a #b", " a", 'say "x"', "it's", "a=b", "$DR_WORLD_NAME #1"])
def test_a_value_reads_back_as_it_was_given(files, value):
    files.write("run.env", "DR_CAR_NAME=x\n")

    edit(files, DR_CAR_NAME=value)

    read = files.load(content(files)).car_name
    assert read == value.replace("$DR_WORLD_NAME", "reinvent_base").strip()


def test_what_a_line_cannot_hold_is_refused(files):
    with pytest.raises(SettingsError, match=r"^run\.env line 2: DR_CAR_NAME=.*cannot be written"):
        edit(files, DR_CAR_NAME="it's $DR_WORLD_NAME")


def test_mistakes_of_before_may_stay_and_are_told(files):
    files.write("run.env", "DR_EVAL_MAX_RESETS=-1\nDR_TRAIN_SEED=x\n")

    done = edit(files, DR_TRAIN_SEED="4")

    assert content(files) == b"DR_EVAL_MAX_RESETS=-1\nDR_TRAIN_SEED=4\n"
    assert done.warnings == (
        "run.env line 1: DR_EVAL_MAX_RESETS=-1 is below 0. This was wrong before.",
    )


def test_a_stronger_environment_is_told_and_hides_no_mistake(files):
    environ = {"DR_WORKERS": "2"}

    done = edit(files, environ, DR_WORKERS="3")

    assert done.warnings == (
        "environment: DR_WORKERS is set there and overrides system.env. Remove it with "
        "`unset DR_WORKERS`.",
    )
    with pytest.raises(SettingsError, match="DR_WORKERS=1001 is above 1000"):
        edit(files, environ, DR_WORKERS="1001")


def test_a_stronger_file_is_told(files):
    done = set_values(files.path, {"DR_CAR_NAME": "Slow"}, file="system.env", environ={})

    assert content(files, "system.env").endswith(b"DR_CAR_NAME=Slow\n")
    assert done.warnings == (
        "run.env line 2: DR_CAR_NAME is set there too and overrides system.env.",
    )


def test_a_setting_without_effect_is_told(files):
    done = edit(files, DR_KINESIS_STREAM_NAME="live")

    assert done.warnings == (
        "system.env line 3: DR_KINESIS_STREAM_NAME=live has no effect: no camera stream is "
        "published.",
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"\xef\xbb\xbfDR_TRAIN_SEED=1\r\n# x\r\n", b"\xef\xbb\xbfDR_TRAIN_SEED=2\r\n# x\r\n"),
        (b"# x\r\nDR_WORKERS=1", b"# x\r\nDR_WORKERS=1\r\nDR_TRAIN_SEED=2\r\n"),
        (b'DR_TRAIN_SEED="1" # why\nDR_WORKERS=1', b'DR_TRAIN_SEED="2" # why\nDR_WORKERS=1'),
    ],
    ids=["mark-and-windows-line-ends", "no-final-newline", "quotes-and-comment"],
)
def test_the_form_of_a_file_stays(files, before, after):
    files.write("run.env", before)

    edit(files, DR_TRAIN_SEED="2")

    assert content(files) == after


def test_an_edit_that_changes_nothing_leaves_the_file_alone(files):
    before = (files.path / "run.env").stat()

    edit(files, DR_CAR_NAME="Fast Car")

    assert (files.path / "run.env").stat() == before


def test_edits_at_once_lose_nothing(files):
    names = [name for name, known in catalogue().items() if known.kind == "flag"][:12]

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda name: edit(files, **{name: "True"}), names))

    written = content(files) + content(files, "system.env")
    assert [written.count(f"{name}=True\n".encode()) for name in names] == [1] * len(names)


def test_a_folder_without_run_env_is_refused(tmp_path):
    with pytest.raises(SettingsError, match=r"run\.env: there is no such file"):
        set_values(tmp_path, {"DR_TRAIN_SEED": "1"}, environ={})


def test_a_file_that_is_not_as_it_was_seen_is_not_changed(files):
    seen = {"run.env": version_of(content(files)), "other.env": "x"}
    before = content(files)

    set_values(files.path, {"DR_CAR_NAME": "Blue"}, environ={}, seen=seen, keep_old=True)

    assert content(files, "run.env.bak") == before
    with pytest.raises(FilesChanged, match=r"run\.env was changed"):
        set_values(files.path, {"DR_CAR_NAME": "Red"}, environ={}, seen=seen)
    assert b"Blue" in content(files)


def test_a_check_alone_changes_nothing(files):
    before = content(files)

    done = set_values(files.path, {"DR_CAR_NAME": "Blue"}, environ={}, write=False)

    assert done.changes[0].after == "Blue"
    assert content(files) == before
