"""What the community's notebooks call, in their order, works on our models in a bucket.

Source: the calls of Training_analysis, Evaluation_analysis, ActionSpace_analysis and Metrics of
deepracer-analysis.
"""

import numpy as np
import pytest

pytest.importorskip("deepracer.logs", reason="needs the package deepracer-utils")

import boto3
import matplotlib as mpl
import matplotlib.pyplot as plt
from moto import mock_aws

from simtraces import TRACK, WORLD, write_model

BUCKET, PREFIX = "bucket", "team/model-1"

KINDS = {
    "one worker": {},
    "three workers": {"workers": 3},
    "continuous actions": {"continuous": True},
}

pytestmark = pytest.mark.filterwarnings("ignore")  # as the notebooks do


@pytest.fixture(scope="module")
def notebook(libraries, tmp_path_factory):
    """The library without a screen, and tracks where a notebook looks for them."""
    folder = tmp_path_factory.mktemp("notebook")
    (folder / "tracks").mkdir()
    points = np.hstack([TRACK.center, TRACK.inner, TRACK.outer])
    np.save(folder / "tracks" / f"{WORLD}.npy", points)
    with mpl.rc_context({"figure.dpi": 10}), pytest.MonkeyPatch.context() as patch:
        plt.switch_backend("Agg")
        patch.setattr(plt, "show", lambda *_, **__: None)
        patch.chdir(folder)
        yield libraries
        plt.close("all")


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Puts a model into a bucket and returns its prefix."""
    with pytest.MonkeyPatch.context() as patch, mock_aws():
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "testing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        bucket = boto3.resource("s3").create_bucket(Bucket=BUCKET)

        def putting(kind):
            prefix = f"{PREFIX}-{kind.replace(' ', '-')}"
            folder = tmp_path_factory.mktemp("model")
            write_model(folder, iterations=2, episodes=7, laps_from=1, **KINDS[kind])
            for path in folder.rglob("*"):
                if path.is_file():
                    key = f"{prefix}/{path.relative_to(folder).as_posix()}"
                    bucket.put_object(Key=key, Body=path.read_bytes())
            return prefix

        yield {kind: putting(kind) for kind in KINDS}


@pytest.fixture
def kind(request):
    """Which model a notebook opens."""
    return request.param


@pytest.fixture
def log(notebook, stored, kind):
    """The model as a notebook opens it."""
    handler = notebook.S3FileHandler(bucket=BUCKET, prefix=stored[kind], s3_endpoint_url=None)
    yield notebook.DeepRacerLog(filehandler=handler)
    plt.close("all")


@pytest.fixture
def track():
    """The track, chosen by its name from the files."""
    from deepracer.tracks import TrackIO

    files = TrackIO()
    assert list(files.get_tracks()) == [f"{WORLD}.npy"]
    return files.load_track(WORLD)


@pytest.mark.parametrize("kind", ["three workers"], indirect=True)
def test_training_analysis(notebook, log, kind, track):
    from deepracer.tracks.track_utils import track_breakdown

    utils, plots = notebook.AnalysisUtils, notebook.PlottingUtils
    plots.plot_trackpoints(track)
    log.load()
    assert log.agent_and_network()["network"]
    assert log.hyperparameters()["num_episodes_between_training"] == 7 * workers_of(kind)
    assert log.action_space()
    steps = log.dataframe()
    steps["throttle"], steps["steer"] = steps["speed"], steps["steering_angle"]
    episodes = utils.simulation_agg(steps, secondgroup="unique_episode")
    assert len(episodes) == 2 * 7 * workers_of(kind)
    utils.analyze_training_progress(episodes, title="progress", groupby_field="unique_episode")
    utils.scatter_aggregates(episodes, "all")
    complete = episodes[episodes["progress"] == 100]
    assert len(complete) == len(episodes) / 2
    utils.scatter_aggregates(complete, "complete")
    utils.scatter_by_groups(episodes, title="fifths")
    assert complete.nlargest(5, "new_reward")["reward"].is_monotonic_decreasing
    assert len(complete.nsmallest(5, "time")) == 5
    steps[steps["episode"] == 9].plot.bar(x="closest_waypoint", y="reward")
    best = episodes.nlargest(1, "progress")
    plots.plot_selected_laps(best, steps, track, section_to_plot="unique_episode")
    plots.plot_selected_laps([1], steps, track, section_to_plot="iteration")
    plots.plot_track(steps[steps["iteration"] == 1], track)
    notebook.ActionBreakdownUtils.action_breakdown(
        steps, track, track_breakdown=track_breakdown.get("reinvent2018"), episode_ids=[12]
    )
    assert plt.get_fignums()


@pytest.mark.parametrize("kind", ["one worker"], indirect=True)
def test_evaluation_analysis(notebook, log, track):
    utils, plots = notebook.AnalysisUtils, notebook.PlottingUtils
    log.load_evaluation_trace()
    steps = log.dataframe()
    trials = utils.simulation_agg(steps, "stream", is_eval=True)
    utils.scatter_aggregates(trials, is_eval=True)
    complete = trials[trials["progress"] == 100]
    utils.scatter_aggregates(complete, "complete", is_eval=True)
    plots.plot_evaluations(steps, track)
    [stream, number] = complete.nsmallest(1, "time")[["stream", "episode"]].iloc[0]
    lap = steps[(steps["episode"] == number) & (steps["stream"] == stream)].copy()
    lap["distance"] = np.hypot(lap["x"].diff(), lap["y"].diff())
    lap["progress_delta"] = lap["progress"].astype(float).diff()
    assert np.isfinite(lap[["distance", "progress_delta"]].iloc[1:].to_numpy(float)).all()
    plots.plot_grid_world(lap, track, graphed_value="reward")
    assert plt.get_fignums()


@pytest.mark.parametrize("kind", ["one worker", "continuous actions"], indirect=True)
def test_action_space_analysis(notebook, log, kind, track):
    log.load_training_trace()
    steps = log.dataframe().sort_values(["episode", "steps"])
    assert int(log.hyperparameters()["num_episodes_between_training"]) % 7 == 0
    if "worker" in steps:
        assert steps["worker"].nunique() == workers_of(kind)
    used = steps[steps["steps"] != 0].groupby("action", as_index=False)
    medians = used[["steering_angle", "speed"]].median()
    if kind == "continuous actions":
        assert list(medians["action"]) == [-1]
    else:
        listed = [entry["steering_angle"] for entry in log.action_space()]
        for action, angle in zip(medians["action"], medians["steering_angle"], strict=True):
            assert listed[action] == angle
    notebook.PlottingUtils.plot_track(steps, track, value_field="reward")


@pytest.mark.parametrize("kind", ["three workers"], indirect=True)
def test_metrics(stored, kind):
    from deepracer.logs import metrics

    found = metrics.TrainingMetrics(BUCKET)
    found.addRound(stored[kind], training_round=1, workers=workers_of(kind))
    summary = found.getSummary(method="mean", summary_index=["r-i", "master_iteration"])
    assert len(summary) == 2
    driven, evaluated = found.getTraining(), found.getEvaluation()
    assert (len(driven), len(evaluated)) == (2 * 7 * workers_of(kind), 2)
    assert max(driven["master_iteration"]) == 1
    found.plotProgress(method=["median", "mean", "max"], rolling_average=5, figsize=(20, 5))
    found.plotProgress(
        method=["mean"],
        rolling_average=20,
        series=[
            ("eval_completed", "Evaluation", "orange"),
            ("train_completed", "Training", "blue"),
        ],
        completedLapsOnly=False,
        grid=True,
    )
    assert len(driven[driven["complete"] == 1].nsmallest(5, ["time"])) == 5


def workers_of(kind):
    """Simulation workers of a model."""
    return KINDS[kind].get("workers", 1)
