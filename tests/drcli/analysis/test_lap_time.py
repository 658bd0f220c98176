"""One lap has one time, whoever reads it: that of the metrics, from the reset to the last step.

Two programs of others do not count the step of the reset: deepracer-utils tells a step less, and
log-guru, which adds 0.2 s to what it measures, two steps more.
"""

import json
from dataclasses import replace

import pytest

from drcli.analysis.findings.evidence import gather
from drcli.analysis.read_metrics import trials_of
from drcli.analysis.report.lap_choice import choose_laps
from drcli.analysis.report.map_section import map_data
from drcli.races.race_queue import lap_driven
from drcli.records.episode_metrics import (
    EpisodeMetrics,
    TrialMetrics,
    encode_metrics_file,
    is_clean,
)
from drcli.records.trace import STEP_S, Episode, log_lines, read_csv
from drcli.run.evaluation_report import COMPLETE, trial_reports
from drcli.view.video.recorded_lap import read_laps
from simtraces import episode, put, trace, with_reset, write_model


def driven_laps() -> list[Episode]:
    """A clean lap, one with a reset and a penalty of 5 s, and one that was not completed."""
    clean = episode(0, 203, progress=100.0, phase="evaluation")
    helped = with_reset(episode(1, 118, progress=100.0, phase="evaluation"), at=60, pause_steps=75)
    return [clean, helped, episode(2, 40, progress=30.0, phase="evaluation")]


def test_all_readers_tell_the_same_time(read, libraries, tmp_path):
    laps = driven_laps()
    expected = [len(lap.rows) * STEP_S for lap in laps]
    folder = write_model(tmp_path / "model", iterations=0, evaluations=0)
    put(folder, "evaluation-20260102030400/evaluation-simtrace/0-iteration.csv", trace(laps))
    read_run = read(folder)
    [evaluation] = read_run.evaluations
    log = libraries.DeepRacerLog(model_folder=str(folder))
    log.load_evaluation_trace(force=True)
    theirs = libraries.AnalysisUtils.simulation_agg(log.dataframe(), "stream", is_eval=True)
    films, _ = read_laps(trace(laps), "trace")
    logged = [
        [float(line.split(",")[14]) for line in log_lines(lap, 0.0).splitlines()] for lap in laps
    ]
    readers = {
        "episode": [lap.duration_s for lap in laps],
        "metrics of trials": [
            TrialMetrics.of(lap).elapsed_time_in_milliseconds / 1000.0 for lap in laps
        ],
        "dr-evaluate, races": [t.lap_s for t in trial_reports([TrialMetrics.of(x) for x in laps])],
        "metrics of a training": [
            EpisodeMetrics.of(lap, iteration=0, episode=1, trial=1).elapsed_time_in_milliseconds
            / 1000.0
            for lap in laps
        ],
        "trace of a training": [traced.duration_s for traced in read_csv(trace(laps))],
        "dr-analyze": evaluation.trials["time"],
        "video and playback": [film.duration_s for film in films],
    }
    from_first_row_on = {
        "deepracer-utils": theirs["time"],
        "log-guru": [times[-1] - times[0] for times in logged],
    }

    for name, times in readers.items():
        assert list(times) == pytest.approx(expected, abs=0.0006), name
    for name, times in from_first_row_on.items():
        assert list(times) == pytest.approx([lap_s - STEP_S for lap_s in expected]), name


def test_a_lap_with_its_penalty_in_the_metrics_has_the_same_time(read, tmp_path):
    laps = driven_laps()
    folder = write_model(tmp_path / "model", iterations=0, evaluations=0)
    put(folder, "evaluation-20260102030400/evaluation-simtrace/0-iteration.csv", trace(laps))
    metrics = encode_metrics_file([TrialMetrics.of(lap) for lap in laps])
    put(folder, "metrics/evaluation/evaluation-20260102030400.json", metrics)

    [evaluation] = read(folder).evaluations

    trials = evaluation.trials
    assert list(trials["time"]) == [13.533, 12.867, 2.667]
    assert list(trials["penalty_s"]) == pytest.approx([0.0, 5.0, 0.0])
    assert list(trials["driven_s"]) == pytest.approx([13.533, 7.867, 2.667])
    assert list(trials["clean"]) == [True, False, False]
    assert list(trials["complete"]) == [True, True, False]
    assert list(trials["resets"]) == [0, 1, 0]
    assert trials["alone_progress"][1] == pytest.approx(51.0, abs=1.0)
    assert str(evaluation) == "1 of 3 laps clean (1 reset), 2 finished, best 13.53 s"


def test_the_map_of_the_report_shows_it(read, tmp_path):
    folder = write_model(tmp_path / "model", iterations=2, evaluations=0)
    put(
        folder,
        "evaluation-20260102030400/evaluation-simtrace/0-iteration.csv",
        trace(driven_laps()),
    )
    run = read(folder)

    data = map_data(run, choose_laps(run.episodes))

    statuses, laps = data["statuses"], data["laps"]
    shown = [statuses[int(laps["status"][lap])]["name"] for lap in data["groups"]["evaluation-0"]]
    assert shown == ["lap complete", "finished after resets", "off track"]


FAULTS = [
    *("reset_count", "off_track_count", "crash_count"),
    *("immobilized_count", "reversed_count", "penalty_in_milliseconds"),
]


@pytest.mark.parametrize("fault", [None, *FAULTS])
def test_all_readers_of_metrics_agree_on_what_is_a_clean_lap(read, tmp_path, fault):
    record = TrialMetrics(100, 9000, 0, 9000, COMPLETE, 0, 0, 0, 0, 0, 1, 0)
    if fault is not None:
        record = replace(record, **{fault: 1})
    folder = write_model(tmp_path / "model", iterations=0, evaluations=0)
    metrics = encode_metrics_file([record])
    put(folder, "metrics/evaluation/evaluation-20260102030400.json", metrics)
    [evaluation] = read(folder).evaluations
    [entry] = json.loads(metrics)["metrics"]
    [report] = trial_reports([record])
    readers = {
        "metrics": record.clean,
        "metrics of others": is_clean(entry, finished=True),
        "dr-evaluate": report.clean,
        "races": lap_driven(report).clean,
        "dr-analyze": evaluation.trials["clean"][0],
    }

    assert readers == dict.fromkeys(readers, fault is None)


@pytest.mark.parametrize("iterations", [1, 5])
def test_an_evaluation_is_judged_unless_the_training_went_on_after_it(read, tmp_path, iterations):
    folder = write_model(tmp_path / "model", iterations=iterations, evaluations=0)
    put(
        folder,
        "evaluation-20260102030400/evaluation-simtrace/0-iteration.csv",
        trace(driven_laps(), 1.7e9 + 5.0),
    )

    found = gather(read(folder)).evaluated

    assert (found is None) == (iterations == 5)
    if found is not None:
        assert (found.laps.clean, found.laps.driven, found.resets, found.off_track) == (1, 3, 1, 2)
        assert found.alone == pytest.approx((100 + 51 + 30) / 3, abs=1.0)
        assert found.place is not None
        assert found.place.of == 2


def test_the_newest_evaluations_of_a_training_are_five_laps_or_more(read, tmp_path):
    few, enough = (
        gather(read(write_model(tmp_path / f"{n}", iterations=n))).evaluated_in_training
        for n in (4, 7)
    )

    assert few is None
    assert enough is not None
    assert (enough.laps.clean, enough.laps.driven, enough.alone) == (0, 5, 30.0)


@pytest.mark.parametrize("stamp", ["20220709200242", "20220709200509", "20220709200711"])
def test_a_recorded_evaluation_has_the_times_of_its_metrics(reference_run, reference_runs, stamp):
    folder = reference_runs / "drfc-time-trial"
    written = json.loads((folder / f"metrics/EvaluationMetrics-{stamp}.json").read_text())
    expected = [trial["elapsed_time_in_milliseconds"] / 1000.0 for trial in written["metrics"]]
    [evaluation] = [e for e in reference_run("drfc-time-trial").evaluations if e.stamp == stamp]

    assert list(evaluation.trials["time"]) == expected
    # Its trace alone: the clock of the reference ticks beside the steps.
    assert list(trials_of(evaluation.steps)["time"]) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("name", ["drfc-time-trial", "simapp6-continuous"])
def test_recorded_episodes_have_the_times_of_their_metrics(reference_run, name):
    run = reference_run(name)
    records = run.records[run.records["phase"] == "training"]
    measured = records.groupby("episode")["time"].last()
    traced = run.episodes.set_index(run.episodes["episode"] + 1)["time"]
    apart = (traced - measured).dropna()

    assert len(apart) >= 300
    assert abs(float(apart.median())) < 0.006
    assert float((apart.abs() < 0.06).mean()) > 0.95
