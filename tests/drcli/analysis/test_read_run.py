"""What is read of a training, whole or damaged, in every layout."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from counted_episodes import counted_episodes
from drcli.analysis.analysis import analyse
from drcli.base.errors import SettingsError
from drcli.records.iteration import IterationRecord, encode_history
from drcli.records.trace import STEP_S
from simtraces import WORLD, episode, mean_reward, put, trace, write_model


@pytest.mark.parametrize("name", ["drfc-time-trial", "simapp6-continuous"])
def test_the_tables_are_those_of_deepracer_utils(reference_run, reference_runs, libraries, name):
    log = libraries.DeepRacerLog(model_folder=str(reference_runs / name))
    log.load(ignore_metadata=True)
    frame = log.dataframe().assign(new_reward=0.0)
    theirs = libraries.AnalysisUtils.simulation_agg(frame, secondgroup="unique_episode")
    theirs = theirs.set_index("unique_episode")

    run = reference_run(name)

    theirs["time"] += STEP_S  # the library leaves out the step of the reset, and metrics do not
    for column in ("iteration", "steps", "start_at", "progress", "time", "dist", "reward", "speed"):
        assert np.allclose(theirs[column], run.episodes[column], rtol=1e-9, atol=0.0), column
    assert list(theirs["complete"] == 1) == list(run.episodes["complete"])
    assert list(theirs["quintile"].astype(str)) == list(run.episodes["quintile"].astype(str))
    groups = theirs.groupby("iteration")
    assert np.allclose(groups["reward"].mean(), run.iterations["mean_reward"], rtol=1e-9)
    assert np.allclose(groups["progress"].mean(), run.iterations["mean_progress"], rtol=1e-9)
    assert list(groups["complete"].sum()) == list(run.iterations["complete_laps"])
    laps = theirs[theirs["complete"] == 1].groupby("iteration")["time"].min()
    assert np.allclose(laps, run.iterations["best_lap_s"].dropna(), rtol=1e-9)
    assert run.problems == () or "track" in " ".join(run.problems)


def test_everything_of_a_model_of_one_worker_is_read(read, tmp_path):
    run = read(write_model(tmp_path / "model", laps_from=3))

    assert (run.name, run.layout, run.world) == ("model", "drfc", WORLD)
    assert run.track is not None
    assert run.actions is not None
    assert run.actions.num_actions == 3
    assert run.problems == ()
    assert list(run.iterations["mean_reward"]) == [mean_reward(n) for n in range(5)]
    assert list(run.iterations["complete_laps"]) == [0, 0, 0, 4, 4]
    assert run.iterations["best_lap_s"][3] == pytest.approx(8 / 15)
    assert list(run.iterations["eval_mean_progress"]) == [30.0] * 5
    assert list(run.iterations["wall_s"]) == pytest.approx([9.7, 20, 20, 20, 20], abs=0.5)
    assert run.files["reward_function.py"].startswith("def")
    [evaluation] = run.evaluations
    assert evaluation.world == WORLD
    assert list(evaluation.trials["complete"]) == [False, True]


@pytest.mark.parametrize("damaged", [False, True])
def test_the_time_in_the_reward_function_is_read_where_the_traces_have_it(read, tmp_path, damaged):
    model = write_model(tmp_path / "model", iterations=3)
    first, second = (model / f"training-simtrace/{number}-iteration.csv" for number in (0, 1))
    rows = first.read_text().splitlines()
    first.write_text("\n".join(row.rpartition(",")[0] for row in rows) + "\n")
    if damaged:
        rows = second.read_text().splitlines()
        rows[2] = rows[2].rpartition(",")[0] + ",slow"
        second.write_text("\n".join(rows) + "\n")

    run = read(model)

    times = run.steps.groupby("iteration")["reward_ms"]
    assert list(times.count()) == [0, 38 - damaged, 38]
    assert list(times.max())[1:] == pytest.approx([0.004] * 2)
    assert list(run.iterations["mean_reward"]) == [mean_reward(n) for n in range(3)]


def test_workers_are_put_together_also_more_than_ten(read, tmp_path):
    run = read(write_model(tmp_path / "model", workers=12, iterations=2, episodes=1))

    assert run.layout == "drfc-workers"
    assert list(run.episodes.index) == list(range(24))
    assert sorted(set(run.episodes["worker"])) == list(range(12))
    assert list(run.iterations["episodes"]) == [12, 12]


def with_joined_workers(folder):
    """A training of one worker that five joined later; one of those was started again."""
    write_model(folder, iterations=4)
    for worker in range(1, 6):
        for iteration in range(1, 4):
            if (worker, iteration) != (3, 2):
                numbers = range(2 * iteration, 2 * iteration + 2)
                name = f"{worker}/training-simtrace/{iteration}-iteration.csv"
                put(folder, name, trace([episode(n) for n in numbers]))
    return folder


def test_a_worker_and_those_that_joined_it_are_one_training(read, tmp_path):
    run = read(with_joined_workers(tmp_path / "model"))

    assert run.layout == "drfc-workers"
    assert list(run.iterations["episodes"]) == [4, 14, 12, 14]
    assert sorted(set(run.episodes["worker"])) == list(range(6))
    assert not any("left out" in text for text in run.problems)


def test_all_count_the_same_episodes_of_workers_that_joined(tmp_path):
    folder = with_joined_workers(tmp_path / "model")
    (folder / "0").mkdir()
    (folder / "training-simtrace").rename(folder / "0" / "training-simtrace")

    counts = counted_episodes(folder)

    assert set(counts.values()) == {44}, counts


def test_of_two_traces_of_the_first_worker_the_one_beside_those_of_others_counts(read, tmp_path):
    folder = with_joined_workers(tmp_path / "model")
    put(folder, "0/training-simtrace/3-iteration.csv", trace([episode(12)]))

    run = read(folder)

    assert list(run.iterations["episodes"]) == [4, 14, 12, 11]


def test_continuous_actions_have_no_number(read, tmp_path):
    run = read(write_model(tmp_path / "model", continuous=True))

    assert set(run.steps["action"]) == {-1}
    assert run.actions is not None
    assert run.actions.continuous


def test_a_model_that_was_only_evaluated_has_evaluations(read, tmp_path):
    run = read(write_model(tmp_path / "model", iterations=0, evaluations=3))

    assert run.layout == "upload"
    assert [each.stamp for each in run.evaluations] == [f"2026010203040{n}" for n in range(3)]
    assert len(run.iterations) == len(run.episodes) == len(run.steps) == 0


def test_an_uploaded_model_has_the_curve_of_its_metrics(read, tmp_path):
    folder = write_model(tmp_path / "model", evaluations=0)
    shutil.rmtree(folder / "training-simtrace")

    run = read(folder)

    assert list(run.iterations["mean_reward"]) == [mean_reward(n) for n in range(5)]
    assert not run.iterations["traced"].any()


def damaged(folder, name, change):
    path = folder / "training-simtrace" / name
    path.write_bytes(change(path.read_bytes()))


def test_half_a_line_is_left_out_and_told(read, tmp_path):
    folder = write_model(tmp_path / "model")
    damaged(folder, "2-iteration.csv", lambda data: data[:-40])

    run = read(folder)

    whole = read(write_model(tmp_path / "whole"))
    assert len(run.steps) == len(whole.steps) - 1
    assert any("2-iteration.csv has a damaged row in line" in text for text in run.problems)
    assert any("no end, the first in iteration 2" in text for text in run.problems)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "is empty"),
        (b"episode,steps\n1,2\n", "does not name"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "is not a trace"),
        (trace([episode(0)]).splitlines(keepends=True)[0], "has no readable row"),
    ],
)
def test_a_trace_of_which_nothing_is_left_is_named_and_the_rest_analysed(
    read, tmp_path, content, told
):
    folder = write_model(tmp_path / "model")
    damaged(folder, "3-iteration.csv", lambda _: content)

    run = read(folder)

    assert any("3-iteration.csv" in text and told in text for text in run.problems)
    assert list(run.iterations[run.iterations["traced"]].index) == [0, 1, 2, 4]
    assert run.iterations["mean_reward"][4] == mean_reward(4)


def test_words_among_the_numbers_do_not_turn_a_column_into_text(read, tmp_path):
    folder = write_model(tmp_path / "model")
    damaged(folder, "1-iteration.csv", lambda data: data.replace(b"\n4,3.0,", b"\n4,three,", 1))

    run = read(folder)

    assert run.steps["steps"].dtype == "int32"
    assert any("1-iteration.csv has a damaged row" in text for text in run.problems)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    ("column", "word"),
    [
        *[(name, "1e300") for name in ("X", "Y", "yaw", "steer", "throttle", "tstamp")],
        *[(name, "-1e300") for name in ("X", "steer", "throttle", "progress", "track_len")],
        *[("closest_waypoint", "999999999"), ("episode", "5000000000")],
    ],
)
def test_a_number_that_no_car_can_have_is_damage_of_its_step(read, tmp_path, column, word):
    folder = write_model(tmp_path / "model")

    def change(data):
        lines = data.decode().splitlines()
        fields = lines[4].split(",")
        fields[lines[0].split(",").index(column)] = word
        return "\n".join([*lines[:4], ",".join(fields), *lines[5:], ""]).encode()

    damaged(folder, "1-iteration.csv", change)

    run = read(folder)

    whole = read(write_model(tmp_path / "whole"))
    assert len(run.steps) == len(whole.steps) - 1
    assert any("1-iteration.csv has a damaged row in line 5" in text for text in run.problems)
    assert analyse(run).verdict.kind == analyse(whole).verdict.kind


@pytest.mark.parametrize("word", [b"nan", b"inf", b"", b"None"])
def test_a_reward_that_is_no_number_counts_as_nothing_and_is_told(read, tmp_path, word):
    folder = write_model(tmp_path / "model")
    damaged(
        folder, "0-iteration.csv", lambda data: data.replace(b",1,1.0,", b",1," + word + b",", 1)
    )

    run = read(folder)

    assert np.isfinite(run.steps["reward"]).all()
    assert run.episodes["reward"][0] == 6.0
    assert any("1 rewards in 1 episodes" in text for text in run.problems)


def test_without_the_first_iteration_episodes_are_numbered_anew(read, tmp_path):
    folder = write_model(tmp_path / "model")
    (folder / "training-simtrace" / "0-iteration.csv").unlink()
    (folder / "metrics" / "TrainingMetrics.json").unlink()

    run = read(folder)

    assert list(run.episodes.index) == list(range(16))
    assert list(run.iterations.index) == [1, 2, 3, 4]
    assert any("iteration 0" in text for text in run.problems)


def test_a_short_first_iteration_gives_no_episode_the_number_of_another(read, tmp_path):
    folder = write_model(tmp_path / "model")
    damaged(folder, "0-iteration.csv", lambda _: trace([episode(0), episode(1)]))

    run = read(folder)

    assert run.episodes.index.is_unique
    assert list(run.iterations["episodes"]) == [2, 4, 4, 4, 4]


def test_steps_that_are_there_twice_count_once(read, tmp_path):
    folder = write_model(tmp_path / "model")
    damaged(folder, "1-iteration.csv", lambda data: data + data.partition(b"\n")[2])

    run = read(folder)

    assert run.iterations["mean_reward"][1] == mean_reward(1)
    assert any("are there twice" in text for text in run.problems)


def test_a_lost_first_row_does_not_make_an_episode_longer(read, tmp_path):
    folder = write_model(tmp_path / "model")
    damaged(
        folder,
        "0-iteration.csv",
        lambda data: b"\n".join(
            line for line in data.split(b"\n") if not line.startswith(b"1,1.0,")
        ),
    )

    run = read(folder)

    assert run.episodes["time"][1] == pytest.approx(8 / 15)


def test_a_python_list_as_an_action_shifts_no_column(read, tmp_path):
    folder = write_model(tmp_path / "model", continuous=True)
    damaged(folder, "0-iteration.csv", lambda data: data.replace(b"[-20.0 1.5]", b"[-20.0, 1.5]"))

    run = read(folder)

    assert run.problems == ()
    assert run.iterations["mean_reward"][0] == mean_reward(0)


def test_clean_laps_on_tracks_that_are_not_trained_are_read(read, tmp_path):
    folder = write_model(tmp_path / "model", iterations=2)
    record = IterationRecord(
        iteration=0,
        checkpoint="0_Step-0.ckpt",
        episodes=4,
        steps=40,
        total_steps=40,
        mean_reward=1.0,
        mean_progress=10.0,
        full_laps=0,
        best_lap_s=None,
        elapsed_s=1.0,
    )
    second = replace(record, second_progress=[100.0, 100.0, 30.0, 100.0], second_lap_s=[9.0] * 3)
    put(folder, "metrics/history.json", encode_history([second, replace(record, iteration=1)]))

    run = read(folder)

    assert run.iterations["second_clean"].tolist()[0] == 75.0
    assert math.isnan(run.iterations["second_clean"][1])


def test_damaged_small_files_are_told_and_do_without(read, tmp_path):
    folder = write_model(tmp_path / "model")
    put(folder, "model/model_metadata.json", b"{")
    put(folder, "ip/hyperparameters.json", b"[]")
    put(folder, "metrics/TrainingMetrics.json", b'{"metrics": [{"episode": 1}]}')
    put(folder, "metrics/history.json", b"\xff")

    run = read(folder)

    assert run.actions is None
    assert run.hyperparameters == {}
    assert len(run.iterations) == 5
    for name in ("model_metadata", "hyperparameters", "TrainingMetrics", "history"):
        assert any(name in text for text in run.problems), name


def test_the_track_is_found_by_where_the_car_drove(read, tmp_path):
    folder = write_model(tmp_path / "model")
    (folder / "training_params.yaml").unlink()

    run = read(folder)

    assert run.track is not None
    assert run.track.length_m == pytest.approx(17.709, abs=0.001)


def test_a_track_that_is_named_but_not_installed_is_told(read, tmp_path):
    folder = write_model(tmp_path / "model")
    put(folder, "training_params.yaml", b"WORLD_NAME: 'Elsewhere_track'\n")

    run = read(folder)

    assert run.world == "Elsewhere_track"
    assert run.track is None
    assert any("dr-tracks fetch Elsewhere_track" in text for text in run.problems)


def test_entropy_comes_from_a_trainers_log_where_there_is_no_curve(read, tmp_path):
    folder = write_model(tmp_path / "model")
    line = (
        "Policy training> Surrogate loss={}, KL divergence=0.01, Entropy={}, training epoch={}, "
        "learning_rate=0.0003\n"
    )
    text = "".join(line.format(-0.1, 2.0 - n - 0.1 * e, e) for n in range(2) for e in range(3))
    put(folder, "logs/sagemaker/trainer.log", text.encode())

    run = read(folder)

    assert list(run.learner["entropy"]) == pytest.approx([1.8, 0.8])
    assert math.isclose(run.learner["policy_loss"][1], -0.1)


def test_the_logs_of_two_starts_of_the_trainer_follow_each_other(read, tmp_path):
    folder = write_model(tmp_path / "model")
    line = (
        "Policy training> Surrogate loss=0.1, KL divergence=0.01, Entropy={}, training epoch={}, "
        "learning_rate=0.0003\n"
    )
    for start in range(2):
        text = "".join(line.format(5.0 - 2 * start - n, e) for n in range(2) for e in range(3))
        put(folder, f"logs/training/training-2026010{start}-a-sagemaker.log", text.encode())
    put(folder, "logs/training/training-20260101-a-robomaker.log", b"nothing\n")

    run = read(folder)

    assert list(run.learner["entropy"]) == [5.0, 4.0, 3.0, 2.0]


def test_a_model_without_anything_to_analyse_is_refused(read, tmp_path):
    folder = write_model(tmp_path / "model", iterations=0, evaluations=0)

    with pytest.raises(SettingsError, match="no readable trace"):
        read(folder)


def test_of_a_training_on_several_tracks_places_are_those_of_its_own(read, tmp_path):
    write_model(tmp_path, iterations=2, episodes=4)
    for path in sorted((tmp_path / "training-simtrace").glob("*.csv")):
        lines = path.read_text().splitlines()
        length = lines[0].split(",").index("track_len")
        for at, line in enumerate(lines[1:], start=1):
            cells = line.split(",")
            if int(cells[0]) % 2:
                cells[length] = "55.5"
            lines[at] = ",".join(cells)
        path.write_text("\n".join([*lines, ""]))

    run = read(tmp_path)

    assert run.track is not None
    assert len(run.iterations) == 2
    assert set(run.iterations["episodes"]) == {4}, "of all tracks"
    assert (len(run.episodes), run.steps["track_len"].nunique()) == (4, 1)
    assert any("with 4 of 8 episodes" in problem for problem in run.problems)
