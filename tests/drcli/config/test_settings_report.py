"""Each value with the place it comes from, and everything there is to say about the files."""

import pytest

from drcli.config.settings_report import check_settings, find_name, inspect_values, suggestion


def test_each_value_knows_its_place(folder):
    folder.write("system.env", "DR_WORKERS=2\n")
    settings = folder.load(
        "\nDR_CAR_NAME=Comet\n", environ={"DR_TRAIN_SEED": "4"}, flags={"DR_RUN_ID": "1"}
    )

    values = {value.name: value for value in inspect_values(settings).settings}

    places = {
        name: (values[name].value, values[name].source, values[name].file, values[name].line)
        for name in ("DR_WORKERS", "DR_CAR_NAME", "DR_TRAIN_SEED", "DR_RUN_ID", "DR_CLOUD")
    }
    assert places == {
        "DR_WORKERS": ("2", "system.env line 1", "system.env", 1),
        "DR_CAR_NAME": ("Comet", "run.env line 2", "run.env", 2),
        "DR_TRAIN_SEED": ("4", "environment", None, None),
        "DR_RUN_ID": ("1", "flag", None, None),
        "DR_CLOUD": ("local", "default", None, None),
    }


def test_what_follows_from_another_value_is_no_change(folder):
    settings = folder.load(
        "DR_LOCAL_S3_MODEL_PREFIX=m-1\nDR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\n"
    )

    changed = inspect_values(settings, changed=True).settings

    assert [value.name for value in changed] == ["DR_LOCAL_S3_MODEL_PREFIX"]
    (metrics,) = inspect_values(settings, ["DR_LOCAL_S3_METRICS_PREFIX"]).settings
    assert metrics.default == metrics.value == "m-1/metrics"


def test_lists_read_as_they_are_written(folder):
    settings = folder.load('DR_OA_OBJECT_POSITIONS="0.23,-1;0.46,1"\n')

    (value,) = inspect_values(settings, ["DR_OA_OBJECT_POSITIONS"]).settings

    assert value.value == "0.23,-1;0.46,1"


def test_what_one_worker_changes_is_shown_apart(folder):
    folder.write("worker-2.env", "DR_WORLD_NAME=willow\n")
    settings = folder.load("DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=2\n")

    (worker,) = inspect_values(settings).workers

    assert worker.worker == 2
    assert [(v.name, v.value, v.source) for v in worker.settings] == [
        ("DR_WORLD_NAME", "willow", "worker-2.env line 1")
    ]


@pytest.mark.parametrize(
    "line",
    [
        "AWS_SECRET_ACCESS_KEY=pst",
        "MY_PASSWORD=pst",
        "GITHUB_TOKEN=pst",
        "DR_REMOTE_MINIO_URL=http://me:pst@nas:9000",
        "ADDRESS=https://pst@nas/",
        "DR_TRACKS_URL=https://nas/tracks?key=pst",
    ],
)
def test_no_secret_is_shown(folder, line):
    name = line.partition("=")[0]

    (value,) = inspect_values(folder.load(line), [name]).settings

    assert "(hidden)" in value.value
    assert "pst" not in str(value)


@pytest.mark.parametrize("written", ["DR_WORKERS", "dr_workers", "workers", "Workers"])
def test_a_name_may_be_written_short(written):
    assert find_name(written) == "DR_WORKERS"


def test_other_names_of_the_files_are_found_too():
    assert find_name("Team", ["Team"]) == "Team"
    assert find_name("Team") is None


@pytest.mark.parametrize(
    ("written", "hint"),
    [
        ("DR_WORKER", "Did you mean DR_WORKERS?"),
        ("wrld_name", "Did you mean DR_WORLD_NAME?"),
        ("DR_COLLISION_PENALTY", "It is the old name of DR_EVAL_COLLISION_PENALTY."),
        ("xyzzy", "`dr config show` lists all."),
    ],
)
def test_an_unknown_name_is_answered_with_a_hint(written, hint):
    assert suggestion(written).startswith(hint)


def test_a_check_tells_errors_warnings_and_what_has_no_effect(folder):
    folder.write("system.env", "DR_DOCKER_STYLE=swarm\n")
    folder.write("run.env", "DR_KINESIS_STREAM_NAME=live\n")

    report = check_settings(folder.path, environ={})

    assert report.errors == ()
    assert report.warnings == (
        "run.env line 1: DR_KINESIS_STREAM_NAME=live has no effect: no camera stream is published.",
    )
    assert [group.names for group in report.without_effect] == [
        ("DR_DOCKER_STYLE",),
        ("DR_KINESIS_STREAM_NAME",),
    ]


def test_a_check_of_wrong_settings_keeps_the_findings_apart(folder):
    folder.write("run.env", "DR_WORKERS=-1\nTEAM=x\nDR_EVAL_MAX_RESETS=-1\n")

    report = check_settings(folder.path, environ={})

    assert [error.where for error in report.errors] == ["run.env line 1", "run.env line 3"]
    assert report.warnings == ("run.env line 2: TEAM is not a setting and has no effect.",)
