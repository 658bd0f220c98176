"""deepracer-utils reads and draws what our workers write: its public loaders and plots."""

import warnings

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

from simtraces import TRACK, write_model

KINDS = {
    "one worker": {},
    "three workers": {"workers": 3},
    "continuous actions": {"continuous": True},
    "evaluations only": {"iterations": 0},
}


@pytest.fixture(params=KINDS)
def folder(request, tmp_path):
    """A model."""
    options = {"iterations": 2, "episodes": 5, "laps_from": 1, **KINDS[request.param]}
    return write_model(tmp_path / "model", **options)


@pytest.fixture
def quiet(libraries, monkeypatch):
    """The library without a screen: it shows figures, and warns about matplotlib's interfaces."""
    with mpl.rc_context({"figure.dpi": 10}), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plt.switch_backend("Agg")
        monkeypatch.setattr(plt, "show", lambda *_, **__: None)
        yield libraries
        plt.close("all")


def workers_of(folder):
    """Number of workers that have traces."""
    return len(list(folder.rglob("training-simtrace")))


def test_the_loaders_read_it(quiet, folder):
    log = quiet.DeepRacerLog(model_folder=str(folder))
    workers = workers_of(folder)
    if workers:
        log.load()
        assert log.dataframe()["unique_episode"].nunique() == 2 * 5 * workers
        assert log.hyperparameters()["discount_factor"] == 0.99
        assert log.agent_and_network()["network"] == "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
        assert log.action_space()
        metrics = quiet.TrainingMetrics("none", region="us-east-1")
        for worker in range(workers):
            name = f"TrainingMetrics{f'_{worker}' if worker else ''}.json"
            metrics.addRound("", fname=str(folder / "metrics" / name), worker=worker)
        assert len(metrics.getTraining()) == 2 * 5 * workers
        assert len(metrics.getEvaluation()) == 2
        assert len(metrics.getSummary()) == 2
        metrics.plotProgress()
        assert len(quiet.SimtraceStabilityAnalyzer(log.dataframe()).analyze()) == 2 * workers
    log.load_evaluation_trace(force=True)
    assert list(log.dataframe()["episode"].unique()) == [0, 1]
    trials = quiet.AnalysisUtils.simulation_agg(log.dataframe(), "stream", is_eval=True)
    assert list(trials["complete"]) == [0, 1]


def test_the_plots_draw_it(quiet, folder):
    from deepracer.tracks.track_utils import Track

    utils, plots = quiet.AnalysisUtils, quiet.PlottingUtils
    track = Track("reinvent_base", np.hstack([TRACK.center, TRACK.inner, TRACK.outer]))
    log = quiet.DeepRacerLog(model_folder=str(folder))
    log.load_evaluation_trace()
    plots.plot_evaluations(log.dataframe(), track)
    if workers_of(folder):
        log.load(force=True)
        steps = log.dataframe()
        if workers_of(folder) == 1:  # test_notebook_calls draws them of several
            episodes = utils.simulation_agg(steps, secondgroup="unique_episode")
            utils.scatter_aggregates(episodes, "title")
            utils.scatter_by_groups(episodes, title="title")
            utils.analyze_training_progress(episodes, groupby_field="unique_episode")
        for style in ("classic", "modern"):
            plots.plot_laps([0, 1], steps, track, "unique_episode", style=style)
        plots.plot_grid_world(steps[steps["unique_episode"] == 4], track)
        plots.plot_track(steps[steps["iteration"] == 0], track)
        # With continuous actions it would draw a picture for each pair, and nothing else ends.
        if (steps["action"] >= 0).all() and workers_of(folder) == 1:
            quiet.ActionBreakdownUtils.action_breakdown(steps, track, iteration_ids=[0])
    assert plt.get_fignums()
