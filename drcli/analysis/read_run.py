"""Reads the files of a training as one `Run`."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from drcli.analysis.model_facts import ModelFacts, model_facts
from drcli.analysis.model_source import ModelSource, open_model
from drcli.analysis.read_metrics import (
    iteration_table,
    learner_table,
    learning_curve,
    metric_records,
    read_evaluations,
)
from drcli.analysis.read_traces import (
    EPISODE_COLUMNS,
    STEP_COLUMNS,
    TraceReading,
    episode_table,
    number_episodes,
    read_console_log,
    read_traces,
)
from drcli.analysis.run import Run, deepracer_logs, spans
from drcli.base.errors import DrError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.config.settings import Settings
from drcli.tracks.limit_store import StoredLimit
from drcli.tracks.track_limit import limit_of
from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

with lazy_imports():
    import pandas as pd

MOST_TRACE_BYTES = 1 << 30
"""About five million steps; of more, every n-th iteration is read."""

_NUMBER_RANGE = 3


def read_run(settings: Settings, what: str | None, *, local: bool = False) -> Run:
    """Find a model and read it; see `open_model`.

    Raises:
        SettingsError: There is no such model, or nothing to analyse.
        StorageError: A bucket cannot be read.
        NotAvailable: The extra is not installed.
    """
    deepracer_logs()
    source = open_model(settings, what, local=local)
    return run_of(source, settings.tracks_folder, settings.directory)


def read_runs(settings: Settings, names: Sequence[str], *, local: bool = False) -> list[Run]:
    """Find and read two or more models.

    Raises:
        SettingsError: One is named twice, does not exist, or has nothing to analyse.
        StorageError: A bucket cannot be read.
        NotAvailable: The extra is not installed.
    """
    deepracer_logs()
    sources = [open_model(settings, name, local=local) for name in names]
    places: dict[tuple[str, str], str] = {}
    for name, source in zip(names, sources, strict=True):
        where = source.origin if source.bucket else str(Path(source.origin).resolve())
        place = (where, source.files.root)
        if place in places:
            twice = f"{name} is named twice"
            if places[place] != name:
                twice = f"{places[place]} and {name} are the same model"
            raise SettingsError(
                f"{twice} ({source.origin}), so there is nothing to compare.",
                remedy="Name two different models.",
            )
        places[place] = name
    return [run_of(source, settings.tracks_folder, settings.directory) for source in sources]


def run_of(source: ModelSource, tracks: Path, directory: Path) -> Run:
    """Read a model.

    Raises:
        SettingsError: There is nothing in it to analyse.
        StorageError: The bucket cannot be read.
    """
    problems = [*source.problems, *source.files.problems]
    facts = model_facts(source, problems)
    reading = _read_steps(source, facts, problems)
    records = metric_records(source, problems)
    curve = learning_curve(source, problems)
    if reading.steps is None:
        steps = pd.DataFrame(columns=[*STEP_COLUMNS, "unique_episode"])
        episodes = pd.DataFrame(columns=list(EPISODE_COLUMNS))
        episodes.index.name = "unique_episode"
    else:
        steps, found = number_episodes(reading.steps)
        reading.steps = None
        problems += found
        problems += _without_bad_rewards(steps)
        problems += _cut_off(steps)
        episodes = episode_table(steps)
    iterations = iteration_table(steps, episodes, records, curve)
    problems += _gaps(iterations)
    if _has_several_tracks(steps):
        steps, episodes = _on_main_track(facts, steps, episodes, tracks, problems)
        laps = episodes[episodes["complete"].astype(bool)].groupby("iteration")["time"]
        iterations["best_lap_s"], iterations["mean_lap_s"] = laps.min(), laps.mean()
    world, track = _world(facts, steps, tracks, problems)
    worlds = partial(_evaluation_world, tracks, [] if track is None else [track])
    evaluations = read_evaluations(source, facts.evaluation_world, worlds, problems)
    if not len(iterations) and not evaluations:
        why = " ".join(problems[:_NUMBER_RANGE])
        raise SettingsError(
            f"{source.origin} has no readable trace, metrics or evaluation. {why}".strip(),
            remedy="Train or evaluate the model first, or name another one.",
        )
    return Run(
        name=source.name,
        origin=source.origin,
        layout=source.files.layout,
        world=world,
        track=track,
        hyperparameters=facts.hyperparameters,
        actions=facts.actions,
        steps=steps,
        episodes=episodes,
        iterations=iterations,
        learner=learner_table(source, curve, problems),
        evaluations=evaluations,
        problems=tuple(dict.fromkeys(problems)),
        parent=facts.parent,
        files=facts.files,
        parent_files=facts.parent_files,
        records=records,
        machine_hours=facts.machine_hours,
        cost_usd=facts.cost_usd,
        limit=_limit(world, track, facts.car, tracks, directory),
    )


def _limit(
    world: str | None, track: Track | None, car: str | None, tracks: Path, directory: Path
) -> StoredLimit | None:
    if world is None or track is None or car is None:
        return None
    return limit_of(world, tracks, directory, reverse=track.reverse, car=car)


def _read_steps(source: ModelSource, facts: ModelFacts, problems: list[str]) -> TraceReading:
    files = source.files.traces
    if not files:
        return read_console_log(source, facts.episodes_per_iteration, problems)
    sizes = source.objects.sizes
    total = sum(sizes[file.name] for file in files)
    every = -(-total // MOST_TRACE_BYTES)
    if every > 1:
        numbers = sorted({file.iteration for file in files})
        kept = set(numbers[::every])
        files = tuple(file for file in files if file.iteration in kept)
        problems.append(
            f"The traces have {total / 1e9:.1f} GB; the steps of {len(kept)} of {len(numbers)} "
            "iterations are analysed, evenly spread."
        )
    reading = read_traces(files, source.objects.read)
    problems += reading.problems
    return reading


_SAME_LENGTH = 0.01


def _has_several_tracks(steps: "pd.DataFrame") -> bool:
    """Whether one worker drove several (DR_TRAIN_WORLDS)."""
    lengths = steps.groupby("worker")["track_len"]
    return bool((lengths.max() > (1.0 + _SAME_LENGTH) * lengths.min()).any())


def _on_main_track(
    facts: ModelFacts,
    steps: "pd.DataFrame",
    episodes: "pd.DataFrame",
    tracks: Path,
    problems: list[str],
) -> "tuple[pd.DataFrame, pd.DataFrame]":
    """What was driven on DR_WORLD_NAME, or on the track of most steps where that is not known."""
    track = None if facts.world is None else open_track(facts.world, tracks)
    lengths = steps["track_len"]
    length_m = float(lengths.mode()[0] if track is None else track.length_m)
    kept = steps[np.abs(lengths - length_m) <= _SAME_LENGTH * length_m]
    own = episodes[episodes.index.isin(kept["unique_episode"])]
    problems.append(
        f"The training drove on several tracks. What is said about lap times, episodes and places "
        f"is about the one of {length_m:.2f} m, with {len(own):,} of {len(episodes):,} episodes."
    )
    return kept, own


def _without_bad_rewards(steps: "pd.DataFrame") -> list[str]:
    bad = ~np.isfinite(steps["reward"].to_numpy(float))
    if not bad.any():
        return []
    steps.loc[bad, "reward"] = 0.0
    of = steps.loc[bad, ["iteration", "unique_episode"]]
    return [
        f"{int(bad.sum()):,} rewards in {of['unique_episode'].nunique():,} episodes are not "
        f"numbers (the first in iteration {int(of['iteration'].iloc[0])}); they count as 0."
    ]


def _cut_off(steps: "pd.DataFrame") -> list[str]:
    _, last = spans(steps["unique_episode"].to_numpy())
    ends = steps["iteration"].to_numpy()[last]
    open_ends = ends[~steps["done"].to_numpy(bool)[last]]
    if not len(open_ends):
        return []
    count = "An episode has" if len(open_ends) == 1 else f"{len(open_ends):,} episodes have"
    return [
        f"{count} no end, the first in {_numbers([int(open_ends[0])])}: a trace was cut off, and "
        "episodes may be missing there."
    ]


def _gaps(iterations: "pd.DataFrame") -> list[str]:
    if not len(iterations) or not iterations["traced"].any():
        return []
    expected = range(int(iterations.index[0]), int(iterations.index[-1]) + 1)
    expected = range(0 if iterations.index[0] < len(iterations) else expected.start, expected.stop)
    without = [n for n in expected if n not in iterations.index]
    untraced = [int(n) for n in iterations.index[~iterations["traced"]]]
    told = []
    if untraced:
        told.append(
            f"There is no trace of {_numbers(untraced)}; the metrics tell rewards and progress, "
            "but not the steps."
        )
    if without:
        told.append(f"Of {_numbers(without)}, there is neither a trace nor a metrics record.")
    return told


def _numbers(iterations: list[int]) -> str:
    starts = [n for n in iterations if n - 1 not in iterations]
    ends = [n for n in iterations if n + 1 not in iterations]
    parts = [f"{a}" if a == b else f"{a} to {b}" for a, b in zip(starts, ends, strict=True)]
    if len(parts) > 2 * _NUMBER_RANGE:
        return f"{len(iterations)} iterations"
    return ("iteration " if len(iterations) == 1 else "iterations ") + ", ".join(parts)


def _world(
    facts: ModelFacts, steps: "pd.DataFrame", tracks: Path, problems: list[str]
) -> tuple[str | None, Track | None]:
    first = steps[steps["worker"] == steps["worker"].min()] if len(steps) else steps
    lengths = steps.groupby("worker")["track_len"].median() if len(steps) else steps["track_len"]
    if len(lengths) and float(lengths.max()) > 1.02 * float(lengths.min()):
        problems.append(
            "The workers drove on different tracks; maps show that of worker "
            f"{int(first['worker'].iloc[0])}."
        )
    if facts.world is not None:
        track = open_track(facts.world, tracks)
        if track is None:
            problems.append(
                f"The track {facts.world} is not installed, so there is no map: fetch it with "
                f"`dr-tracks fetch {facts.world}`."
            )
            return facts.world, None
        directed = directed_as_driven(track, first)
        if directed is None:
            problems.append(
                f"The files name the track {facts.world}, but the traces were driven elsewhere; "
                "another track is looked for."
            )
        else:
            return facts.world, directed
    found = fitting_track(first, tracks) if len(first) else None
    if found is not None:
        return found.name, found
    if len(first):
        problems.append(
            f"None of the installed tracks, of which one would have "
            f"{float(first['track_len'].median()):.2f} m, is that of the traces: there is no map. "
            "`dr-tracks fetch NAME` fetches one."
        )
    return facts.world, None


def _evaluation_world(
    tracks: Path, known: list[Track], steps: "pd.DataFrame", named: str | None
) -> str | None:
    """A track that is found is added to the `known` ones."""
    if named is not None:
        track = open_track(named, tracks)
        if track is None or directed_as_driven(track, steps) is not None:
            return named
    for track in known:
        if directed_as_driven(track, steps) is not None:
            return track.name
    found = fitting_track(steps, tracks)
    if found is None:
        return None
    known.append(found)
    return found.name


# Finds the track of a training, by name or driven positions.


LENGTH_TOLERANCE = 0.02
NEAR_M = 0.5
"""Waypoints are 0.3 m apart, the road is 0.6 to 1.5 m wide."""

_SAMPLES = 2000


def open_track(world: str, folder: Path) -> Track | None:
    """The installed track of this name, which may not be a path: files come from strangers."""
    if "/" in world or "\\" in world:
        return None
    try:
        return load_track(world, folder)
    except (TrackError, DrError, OSError):
        return None


def directed_as_driven(track: Track, steps: "pd.DataFrame") -> Track | None:
    """A track in the direction of the steps; None if they were driven elsewhere."""
    sample = _sample(steps)
    if not len(sample):
        return track
    turned = track.reversed()
    forward, backward = _distances(track, sample), _distances(turned, sample)
    if forward is None or backward is None:
        return None
    # Where the direction alternates, each fits a part of the steps.
    if float(np.median(np.minimum(forward, backward))) > NEAR_M:
        return None
    return turned if np.median(backward) < np.median(forward) else track


def fitting_track(steps: "pd.DataFrame", folder: Path) -> Track | None:
    """The first known track that steps were driven on, or None."""
    sample = _sample(steps)
    best: tuple[float, Track] | None = None
    for world in known_worlds(folder):
        track = open_track(world, folder)
        if track is None:
            continue
        for candidate in (track, track.reversed()):
            misfit = _misfit(candidate, sample)
            # Routes that hardly differ are the same track on other ground.
            if misfit is not None and (best is None or misfit < 0.98 * best[0]):
                best = misfit, candidate
    return best[1] if best else None


def _sample(steps: "pd.DataFrame") -> "pd.DataFrame":
    return steps.iloc[:: max(1, len(steps) // _SAMPLES)]


def _misfit(track: Track, sample: "pd.DataFrame") -> float | None:
    distances_m = _distances(track, sample)
    if distances_m is None:
        return None
    median_m = float(np.median(distances_m))
    return median_m if median_m <= NEAR_M else None


def _distances(track: Track, sample: "pd.DataFrame") -> Floats | None:
    if not len(sample):
        return None
    length_m = float(np.hypot(*np.diff(track.center, axis=0).T).sum())
    told_m = float(sample["track_len"].median())
    if abs(told_m - length_m) > LENGTH_TOLERANCE * length_m:
        return None
    waypoints = sample["closest_waypoint"].to_numpy()
    if waypoints.max() >= len(track.center):
        return None
    x, y = (sample[["x", "y"]].to_numpy(float) - track.center[waypoints]).T
    return np.asarray(np.hypot(x, y))
