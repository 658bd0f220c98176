"""The table of many evaluations: order, reasons, and the best as a start."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError
from drcli.base.files import save_record
from drcli.model import keys
from drcli.records.episode_metrics import TrialMetrics
from drcli.records.evaluation_task import EvaluationTask, RobustCell, RobustResult, TaskOutcome
from drcli.records.job import Job
from drcli.records.run_record import EvaluationRecord
from drcli.run import many_evaluations
from drcli.run.many_evaluations import ManyPlan, Refused, run_many, training_command

STAMP = "20260102030405"


def trial(number: int, lap_s: float | None) -> TrialMetrics:
    status, percent = ("Lap complete", 100.0) if lap_s else ("Off track", 40.0)
    return TrialMetrics(
        completion_percentage=percent,
        metric_time=0.0,
        start_time=0.0,
        elapsed_time_in_milliseconds=1000.0 * (lap_s or 5.0),
        episode_status=status,
        crash_count=0,
        immobilized_count=0,
        off_track_count=0 if lap_s else 1,
        reversed_count=0,
        reset_count=0,
        trial=number,
    )


def laps(*times_s: float | None) -> TaskOutcome:
    return TaskOutcome(trials=[trial(n + 1, lap_s) for n, lap_s in enumerate(times_s)])


class Ended:
    """A worker process that has ended already."""

    pid = 4242

    def poll(self) -> int:
        return 0


@pytest.fixture
def run(racer, monkeypatch):
    """Runs a plan whose workers leave these outcomes, by model and track."""
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=a", "DR_EVAL_AVERAGE_LAPS=2")
    started = []

    def run(outcomes, *, refused=(), cores=2, threads=0, fresh_laps=0, compares=False):
        (racer.folder / "system.env").write_text(f"DR_THREADS={threads}\n")
        folder = racer.folder / "job"
        folder.mkdir()
        tasks = [
            EvaluationTask(
                number,
                prefix,
                f"{prefix}/metrics",
                f"{prefix}.ckpt",
                world,
                STAMP,
                fresh_laps=fresh_laps,
            )
            for number, (prefix, world) in enumerate(outcomes)
        ]
        worlds = list(dict.fromkeys(world for _, world in outcomes))
        job = Job(racer.settings().run, "s", 0, None, folder, launcher_pid=1, tasks=tuple(tasks))

        def start(job, name, module, *arguments):
            started.append((name, arguments))
            for task, outcome in zip(tasks, outcomes.values(), strict=True):
                if outcome is not None:
                    save_record(folder / task.outcome_file, outcome)
            return Ended()

        monkeypatch.setattr(many_evaluations, "start_process", start)
        monkeypatch.setattr(many_evaluations, "open_bucket", lambda *_, **__: racer.bucket)
        monkeypatch.setattr("drcli.workers.cores.cores", lambda: cores)
        monkeypatch.setattr(many_evaluations, "POLL_S", 0.0)
        report = run_many(ManyPlan(job, STAMP, worlds, list(refused), compares))
        assert not folder.exists()
        return report, started

    return run


def test_the_log_of_each_process_is_sent(run, monkeypatch):
    sent = []

    def sending(job, names):
        sent.extend(names)
        return nullcontext()

    monkeypatch.setattr(many_evaluations, "sent_to_cloud_watch", sending)
    run({("a", "x"): laps(1.0), ("b", "x"): laps(1.0), ("c", "x"): laps(1.0)}, cores=2)

    assert sent == ["evaluation", "evaluation-1"]


def test_rows_are_sorted_by_track_then_by_laps_average_and_best_lap(run, racer):
    report, _ = run(
        {
            ("slow", "x"): laps(12.0, 12.0, 12.0),
            ("fast", "x"): laps(9.0, 9.5, 9.25),
            ("wild", "x"): laps(7.0, None, 7.0),
            ("fast", "y"): laps(None, None, None),
            ("slow", "y"): laps(15.0, 14.0, 16.0),
        }
    )

    assert [(row.world, row.prefix) for row in report.rows] == [
        ("x", "fast"),
        ("x", "slow"),
        ("x", "wild"),
        ("y", "slow"),
        ("y", "fast"),
    ]
    assert report.rows[0].best_average_s == pytest.approx(9.25)
    assert (report.rows[2].best_lap_s, report.rows[2].best_average_s) == (7.0, None)
    assert (report.rows[2].completed, report.rows[2].off_track) == (2, 1)
    assert [(best.world, best.prefix) for best in report.best] == [("x", "fast"), ("y", "slow")]
    assert racer.bucket.get(keys.comparison(STAMP)).startswith(b'{"rows": [{"prefix": "fast"')


def test_a_model_with_resets_comes_after_one_with_fewer_but_clean_laps(run):
    reset = [replace(trial(n, 7.0), reset_count=9, off_track_count=9) for n in (1, 2, 3)]

    report, _ = run(
        {("resets", "x"): TaskOutcome(trials=reset), ("clean", "x"): laps(9.0, None, 9.5)}
    )

    clean, resets = report.rows
    assert (clean.prefix, clean.clean, clean.best_lap_s, clean.median_s) == ("clean", 2, 9.0, 9.25)
    assert (resets.clean, resets.completed, resets.resets) == (0, 3, 27)
    assert (resets.best_lap_s, resets.best_finished_s) == (None, 7.0)


def test_two_that_drive_from_the_same_starts_are_one_report_with_a_comparison(run):
    report, _ = run(
        {("b", "x"): laps(9.0, 9.0, None), ("a", "x"): laps(8.0, None, None)},
        fresh_laps=3,
        compares=True,
    )

    [found] = report.laps
    assert (found.prefix, found.clean, found.driven, found.seed) == ("b", 2, 3, 0)
    assert found.against.prefix == "a"
    assert (found.comparison.clean_only_first, found.comparison.clean_only_second) == (1, 0)
    assert (found.comparison.both_clean, found.comparison.faster_s) == (1, pytest.approx(-1.0))


def test_a_comparison_of_which_one_side_fails_is_an_error(run):
    with pytest.raises(SettingsError, match="has no weights"):
        run(
            {("a", "x"): laps(8.0), ("b", "x"): TaskOutcome(reason="b has no weights.", code=3)},
            fresh_laps=1,
            compares=True,
        )


def test_models_without_a_result_come_last_with_their_reasons(run):
    report, _ = run(
        {
            ("damaged", "x"): TaskOutcome(reason="0.ckpt is damaged.", remedy="Restore it."),
            ("died", "x"): None,
            ("good", "x"): laps(12.0),
        },
        refused=[Refused("empty", "It has no checkpoint.", "Train it.")],
    )

    assert report.rows[0].prefix == "good"
    reasons = {row.prefix: row.reason for row in report.rows[1:]}
    assert reasons == {
        "damaged": "0.ckpt is damaged.",
        "died": "Its worker process ended without a result.",
        "empty": "It has no checkpoint.",
    }


def test_a_single_model_that_fails_is_an_error_of_its_kind(run):
    with pytest.raises(SettingsError, match="has no weights"):
        run({("a", "x"): TaskOutcome(reason="a has no weights.", remedy="Train.", code=3)})


def test_all_cores_work_but_not_more_processes_than_models(run):
    _, started = run({(name, "x"): laps(9.0) for name in "abc"}, cores=8)

    assert started == [
        ("evaluation", ("0", "3")),
        ("evaluation-1", ("1", "3")),
        ("evaluation-2", ("2", "3")),
    ]


def test_no_more_processes_work_than_the_cores_that_a_run_may_use(run):
    _, started = run({(name, "x"): laps(9.0) for name in "abc"}, cores=8, threads=2)

    assert [arguments for _, arguments in started] == [("0", "2"), ("1", "2")]


def test_other_commands_learn_of_every_model_that_drives(run, monkeypatch):
    seen = []
    load = many_evaluations.load_record

    def look(kind, path):
        seen.append(EvaluationRecord.read(path.parent))
        return load(kind, path)

    monkeypatch.setattr(many_evaluations, "load_record", look)

    run({(prefix, world): laps(9.0) for world in ("bean", "oval") for prefix in "abc"})

    assert {seen[0].prefix, *seen[0].others} == {"a", "b", "c"}


def test_robust_rows_are_sorted_by_their_score(run):
    def grid(prefix, progress):
        cells = [RobustCell("none", "none", 4, 4, progress, 9.0)]
        return TaskOutcome(robust=RobustResult(prefix, "8.ckpt", "x", 0, cells, 1.0))

    report, _ = run({("a", "x"): grid("a", 40.0), ("b", "x"): grid("b", 90.0)})

    assert [(row.prefix, row.robust_score) for row in report.rows] == [("b", 90.0), ("a", 40.0)]
    assert [found.prefix for found in report.robust] == ["b", "a"]


def test_the_command_for_the_best_trains_a_model_of_its_own_there():
    assert training_command("team/a", "tracks/my oval.npy") == (
        "DR_WORLD_NAME='tracks/my oval.npy' DR_LOCAL_S3_PRETRAINED=True "
        "DR_LOCAL_S3_PRETRAINED_PREFIX=team/a "
        "DR_LOCAL_S3_MODEL_PREFIX=team/a-my-oval dr-start-training"
    )
