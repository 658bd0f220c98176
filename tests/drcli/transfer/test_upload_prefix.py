"""The edit of run.env that gives the next upload another name."""

import pytest

from drcli.base.errors import SettingsError
from drcli.model import lease
from drcli.model.model_store import ModelStore
from drcli.transfer.upload import make_upload_increment, plan_upload_increment

from .conftest import put_model


@pytest.fixture
def increment(mover):
    def run(**options):
        planned = plan_upload_increment(mover.settings(), **options)
        make_upload_increment(planned)
        return planned.step

    return run


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("$DR_LOCAL_S3_MODEL_PREFIX-1", "$DR_LOCAL_S3_MODEL_PREFIX-2"),
        ("upload/oval/m-9", "upload/oval/m-10"),
        ("upload", "upload-1"),
        ("rl-deepracer-sagemaker", "rl-deepracer-sagemaker-1"),
    ],
)
def test_the_number_is_raised_in_place(mover, increment, before, after):
    mover.run_env("DR_LOCAL_S3_MODEL_PREFIX=m-3", f"DR_UPLOAD_S3_PREFIX={before} # there", "A=b")

    increment()

    lines = (mover.folder / "run.env").read_text().splitlines()
    assert lines[1:] == [f"DR_UPLOAD_S3_PREFIX={after} # there", "A=b"]
    assert f"{before} # there" in (mover.folder / "run.env.bak").read_text()


def test_a_name_that_is_not_in_the_file_gets_its_own_line(mover, increment):
    mover.run_env("DR_LOCAL_S3_MODEL_PREFIX=m")

    step = increment()

    assert (step.before, step.after) == ("m-1", "m-2")
    assert mover.settings().upload_s3_prefix == "m-2"
    last = (mover.folder / "run.env").read_text().splitlines()[-1]
    assert last == "DR_UPLOAD_S3_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX-2"


def test_a_name_from_system_env_is_raised_in_run_env(mover, increment):
    (mover.folder / "system.env").write_text("DR_UPLOAD_S3_PREFIX=up/7\n")
    mover.run_env("DR_LOCAL_S3_MODEL_PREFIX=m")

    increment()

    assert mover.settings().upload_s3_prefix == "up/8"


@pytest.mark.parametrize("name", ["team/fast", "/team/fast/"])
def test_a_name_of_ones_own_is_taken(mover, increment, name):
    increment(prefix=name)

    assert mover.settings().upload_s3_prefix == "team/fast"


@pytest.mark.parametrize("name", ["fast car", "../fast", "", "a/../b"])
def test_a_name_that_cannot_stand_in_the_bucket_is_refused(mover, increment, name):
    before = (mover.folder / "run.env").read_bytes()

    with pytest.raises(SettingsError, match="DR_UPLOAD_S3_PREFIX="):
        increment(prefix=name)

    assert (mover.folder / "run.env").read_bytes() == before


def test_the_present_name_is_refused(mover, increment):
    with pytest.raises(SettingsError, match="is already team/model-1"):
        increment(prefix="team/model-1")


def test_objects_at_the_new_name_stay_without_w(mover, increment):
    put_model(mover.there, "team/model-2")
    put_model(mover.there, "team/model-3")
    put_model(mover.there, "team/model-33")

    increment()
    kept = len(mover.there.list("team/model-2/"))
    step = increment(wiping=True)

    assert kept > 0
    assert step.wiped == kept
    assert mover.there.list("team/model-3/") == []
    assert mover.there.list("team/model-33/")


def test_our_own_model_is_not_wiped(mover, increment):
    mover.use(mover.here)

    with pytest.raises(SettingsError, match="Target equals source"):
        increment(prefix="team/model", wiping=True)

    assert mover.here.list("team/model/")


def test_a_model_that_is_being_trained_is_not_wiped(mover, increment):
    lease.take(ModelStore(mover.there, "team/model-2"), "theirs")

    with pytest.raises(SettingsError, match="is being trained"):
        increment(wiping=True)


def test_a_value_in_the_environment_would_undo_the_edit(increment, monkeypatch):
    monkeypatch.setenv("DR_UPLOAD_S3_PREFIX", "other")

    with pytest.raises(SettingsError, match="environment: DR_UPLOAD_S3_PREFIX is set there"):
        increment()
