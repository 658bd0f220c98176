"""How many training episodes the analysis, the page and deepracer-utils find in a model."""

import warnings
from pathlib import Path

from drcli.analysis.model_source import open_model
from drcli.analysis.read_run import run_of
from drcli.config.loading import load_settings
from drcli.view.playback.stored_traces import parse_name
from drcli.view.video.recorded_lap import read_laps


def counted_episodes(model: Path) -> dict[str, int]:
    """The counts by reader, of a model on disk."""
    settings = load_settings(model, environ={}, contents={"run.env": b""})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs import DeepRacerLog

        log = DeepRacerLog(model_folder=str(model))
        log.load_training_trace(ignore_metadata=True)
        theirs = log.dataframe().groupby(["worker", "iteration", "episode"]).ngroups
        source = open_model(settings, str(model))
        ours = len(run_of(source, settings.tracks_folder, settings.directory).episodes)
    page = 0
    for file in model.rglob("*-iteration.csv"):
        found = parse_name(file.relative_to(model).as_posix())
        if found is not None and found.kind == "training":
            page += len(read_laps(file.read_bytes(), file.name)[0])
    return {"dr-analyze": ours, "the page": page, "deepracer-utils": theirs}
