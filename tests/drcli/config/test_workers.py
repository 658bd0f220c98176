"""worker-N.env: what each worker beyond the first may have for itself."""

import pytest

from drcli.base.errors import SettingsError
from drcli.config.loading import is_of_worker
from drcli.config.settings import catalogue

MULTI = "DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=3\nDR_WORLD_NAME=reinvent_base\n"


@pytest.fixture
def files(folder):
    def write(second: str, third: str = "DR_WORLD_NAME=bean\n") -> None:
        (folder.path / "worker-2.env").write_text(second)
        (folder.path / "worker-3.env").write_text(third)

    return write


def test_each_worker_drives_its_own_race(folder, files):
    files("DR_WORLD_NAME=willow\n\nDR_RACE_TYPE=OBJECT_AVOIDANCE\nDR_OA_NUMBER_OF_OBSTACLES=2\n")

    s = folder.load(MULTI)

    worlds = [s.for_worker(k).world_name for k in range(3)]
    races = [s.for_worker(k).race_type for k in range(3)]
    assert worlds == ["reinvent_base", "willow", "bean"]
    assert races == ["TIME_TRIAL", "OBJECT_AVOIDANCE", "TIME_TRIAL"]
    assert s.for_worker(1).oa_number_of_obstacles == 2


def test_values_of_one_worker_do_not_leak_into_the_next(folder, files):
    files("DR_TRAIN_REVERSE_DIRECTION=True\n")

    s = folder.load(MULTI)

    assert [s.for_worker(k).train_reverse_direction for k in range(3)] == [False, True, False]


def test_names_of_the_other_files_are_filled_in(folder, files):
    files("DR_WORLD_NAME=${TRACK}\nDR_OA_OBJECT_POSITIONS='0.2,-1;0.6,1'\n")

    s = folder.load(MULTI + "TRACK=paddle\n")

    assert s.for_worker(1).world_name == "paddle"
    assert s.for_worker(1).oa_object_positions == ((0.2, -1), (0.6, 1))


def test_a_worker_s_own_file_wins_over_the_environment(folder, files):
    """Shells in which the reference was activated have all of run.env in their environment."""
    files("DR_WORLD_NAME=willow\n")

    s = folder.load(MULTI, environ={"DR_WORLD_NAME": "reinvent_base"})

    assert s.for_worker(1).world_name == "willow"


def test_the_race_of_a_worker_survives_the_way_to_its_process(folder, files, travelled):
    files("DR_WORLD_NAME=willow\nDR_OA_OBJECT_POSITIONS=0.2,-1\n")

    there = travelled(folder.load(MULTI).run)

    assert there.race(1).world_name == "willow"
    assert there.race(1).oa_object_positions == ((0.2, -1),)
    assert there.race(1).source("DR_WORLD_NAME") == "worker-2.env line 1"


def test_each_worker_may_drive_a_car_of_its_own(folder, files, travelled):
    files("DR_SIM_CAR=2022\n")

    there = travelled(folder.load(MULTI + "DR_SIM_CAR=Low-Grip\n").run)

    assert [there.race(k).sim_car for k in range(3)] == ["low-grip", "2022", "low-grip"]


def test_what_all_workers_share_is_ignored_there_with_a_warning(folder, files):
    files("DR_WORLD_NAME=willow\nDR_LOCAL_S3_BUCKET=other\n")

    s = folder.load(MULTI)

    assert s.for_worker(1).bucket == s.bucket
    assert (
        "worker-2.env line 2: 1 of the settings is the same for all workers: DR_LOCAL_S3_BUCKET."
        in s.warnings
    )


def test_what_a_worker_file_repeats_of_run_env_is_not_told(folder, files):
    shared = "DR_CAR_NAME=Beetle\nDR_TRAIN_RTF=2.0\n"
    files(f"DR_WORLD_NAME=willow\n{shared}")

    warnings = folder.load(MULTI + shared).warnings

    assert not [text for text in warnings if "same for all workers" in text]


def test_a_copy_of_another_run_env_gets_one_line(folder, files):
    names = [name for name in catalogue() if not is_of_worker(name)][:30]
    files("".join(f"{name}={catalogue()[name].default_text}\n" for name in names))

    [warning] = [text for text in folder.load(MULTI).warnings if text.startswith("worker-2.env")]

    assert warning.startswith("worker-2.env line 1: 30 of the settings are the same for all")
    assert names[0] in warning


def test_a_missing_file_of_a_worker_is_named(folder):
    (folder.path / "worker-2.env").write_text("DR_WORLD_NAME=bean\n")

    with pytest.raises(SettingsError, match=r"^worker-3\.env: there is no such file") as refusal:
        folder.load(MULTI)

    assert "set DR_WORKERS to 2" in refusal.value.remedy


def test_a_wrong_value_of_a_worker_is_named_with_its_file_and_line(folder, files):
    files("DR_WORLD_NAME=bean\nDR_RACE_TYPE=RALLY\n")

    with pytest.raises(SettingsError, match=r"^worker-2\.env line 2: DR_RACE_TYPE=RALLY is not"):
        folder.load(MULTI)


def test_what_is_wrong_in_several_files_is_reported_at_once(folder, files):
    files("DR_RACE_TYPE=RALLY\n", "DR_WORLD_NAME=no track\n")

    with pytest.raises(SettingsError) as refusal:
        folder.load(MULTI)

    places = [line.partition(":")[0] for line in str(refusal.value).splitlines()]
    assert places == ["worker-2.env line 1", "worker-3.env line 1"]


def test_a_race_of_two_models_cannot_be_trained_by_any_worker(folder, files):
    files("DR_RACE_TYPE=HEAD_TO_MODEL\n")

    assert str(folder.load(MULTI).untrainable).startswith(
        "worker-2.env line 1: DR_RACE_TYPE=HEAD_TO_MODEL"
    )


def test_without_the_switch_such_files_are_not_read(folder, files):
    files("DR_WORLD_NAME=willow\n")

    s = folder.load("DR_WORKERS=3")

    assert s.overrides == ()
    assert s.for_worker(1) is s
