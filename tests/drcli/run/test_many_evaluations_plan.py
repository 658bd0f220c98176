"""Which models are evaluated on which tracks (001-47), before anything drives."""

import pytest

from drcli.base.errors import ProblemsError, SettingsError
from drcli.model import keys
from drcli.run import many_evaluations
from drcli.run import many_evaluations as many_evaluations_plan
from drcli.run.many_evaluations import Rival, matching_models, prepare_many, run_many, worlds_of


@pytest.fixture
def bucket(racer, monkeypatch):
    """A bucket with team/a and team/b, which are trained, and team/broken, whose files are gone."""
    monkeypatch.setattr(many_evaluations_plan, "open_bucket", lambda *_, **__: racer.bucket)
    for prefix in ("team/a", "team/b"):
        racer.run_env(f"DR_LOCAL_S3_MODEL_PREFIX={prefix}")
        racer.start()
        racer.store(prefix).save(0, 0, b"weights", optimizer=b"")
    racer.bucket.put(keys.coach_checkpoint("team/broken"), b"3_Step-300.ckpt")
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=team/a", "DR_WORLD_NAME=reinvent_base")
    return racer.bucket


def test_every_model_drives_on_every_track(racer, bucket):
    plan = prepare_many(
        racer.settings(), models=["team/[ab]"], worlds=["bean", "reinvent_base"], seed=4
    )

    tasks = plan.job.tasks
    assert [(task.prefix, task.world) for task in tasks] == [
        ("team/a", "bean"),
        ("team/b", "bean"),
        ("team/a", "reinvent_base"),
        ("team/b", "reinvent_base"),
    ]
    assert {task.checkpoint for task in tasks} == {"0_Step-0.ckpt"}
    assert plan.job.seed == 4
    stamps = [task.stamp for task in tasks if task.prefix == "team/a"]
    assert len(set(stamps)) == len(stamps)  # their traces must not overwrite each other


def test_a_model_that_cannot_be_evaluated_has_a_reason_and_hinders_no_other(racer, bucket):
    plan = prepare_many(racer.settings(), models=["team/*"])

    assert [task.prefix for task in plan.job.tasks] == ["team/a", "team/b"]
    [refused] = plan.refused
    assert refused.prefix == "team/broken"
    assert "has no trained model: team/broken/model/model_metadata.json is missing" in (
        refused.reason
    )


def test_without_names_the_model_of_the_settings_drives(racer, bucket):
    plan = prepare_many(racer.settings(), robust=True)

    [task] = plan.job.tasks
    assert (task.prefix, task.world, task.robust) == ("team/a", "reinvent_base", True)


def test_another_checkpoint_or_model_drives_from_the_same_starts(racer, bucket):
    racer.store("team/a").save(1, 100, b"weights", optimizer=b"")
    settings = racer.settings()

    plan = prepare_many(settings, fresh_laps=40, rival=Rival(None, 0))
    other = prepare_many(settings, fresh_laps=40, rival=Rival.parse("team/b/"))

    first, second = plan.job.tasks
    assert (first.checkpoint, second.checkpoint) == ("1_Step-100.ckpt", "0_Step-0.ckpt")
    assert (first.fresh_laps, second.fresh_laps, plan.compares) == (40, 40, True)
    assert first.stamp != second.stamp  # their traces must not overwrite each other
    assert (other.job.tasks[1].prefix, other.job.tasks[1].checkpoint) == ("team/b", "0_Step-0.ckpt")


def test_a_comparison_with_itself_or_with_nothing_is_refused(racer, bucket):
    with pytest.raises(SettingsError, match=r"0_Step-0\.ckpt of team/a, which drives anyway"):
        prepare_many(racer.settings(), fresh_laps=40, rival=Rival.parse("last"))
    with pytest.raises(SettingsError, match="s3://bucket/nobody has no trained model"):
        prepare_many(racer.settings(), fresh_laps=40, rival=Rival.parse("nobody"))


def test_models_of_which_none_can_be_evaluated_have_a_reason_each(racer, bucket, monkeypatch):
    monkeypatch.setattr(many_evaluations, "open_bucket", lambda *_, **__: racer.bucket)
    racer.bucket.put(keys.coach_checkpoint("team/gone"), b"3_Step-300.ckpt")

    report = run_many(prepare_many(racer.settings(), models=["team/broken", "team/gone"]))

    assert [row.prefix for row in report.rows] == ["team/broken", "team/gone"]
    assert all(f"{row.prefix} has no trained model" in row.reason for row in report.rows)


def test_a_name_without_wildcards_is_a_whole_prefix(bucket):
    assert matching_models(bucket, ["team/a"]) == ["team/a"]
    with pytest.raises(SettingsError, match=r"No model in s3://bucket fits --models 'team'"):
        matching_models(bucket, ["team"])


def test_a_pattern_that_fits_nothing_is_refused_with_what_there_is(bucket):
    with pytest.raises(SettingsError, match="it has team/a, team/b, team/broken"):
        matching_models(bucket, ["team/*", "other/*"])


def test_a_track_that_is_not_installed_is_refused_before_anything_drives(racer, bucket):
    with pytest.raises(ProblemsError, match="DR_WORLD_NAME=nowhere is not a known track"):
        prepare_many(racer.settings(), models=["team/*"], worlds=["reinvent_base", "nowhere"])


def test_tracks_are_named_as_in_the_list_of_a_training(racer):
    settings = racer.settings()

    assert worlds_of(settings, "willow, zoo:2 reinvent_w*, Oval_track") == [
        "willow",
        "zoo-0",
        "zoo-1",
        "reinvent_wood",
        "Oval_track",
    ]
    with pytest.raises(ProblemsError, match="--worlds: nowhere is not a known track"):
        worlds_of(settings, "willow, nowhere")
    with pytest.raises(ProblemsError, match="--worlds: no installed track fits Monza\\*"):
        worlds_of(settings, "willow, Monza*")


def test_a_race_between_two_models_is_refused(racer, bucket):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=team/a", "DR_RACE_TYPE=HEAD_TO_MODEL")

    with pytest.raises(SettingsError, match="each model drives alone"):
        prepare_many(racer.settings(), models=["team/*"])
