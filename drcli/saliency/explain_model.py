"""Explains an episode of a model, and writes the findings."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.base.replaceable import make_picture_folder
from drcli.config.checkpoint_words import CheckpointChoice
from drcli.config.settings import Settings
from drcli.models.checkpoint_choice import take_choice
from drcli.saliency.explained_episode import (
    ExplainedEpisode,
    explain_episode,
    place_of,
    shares,
    spread_steps,
)
from drcli.saliency.explanation_pictures import png_of, still
from drcli.saliency.open_policy import open_policy, open_policy_file
from drcli.saliency.policy_outputs import ExplainedPolicy, NotExplainable
from drcli.saliency.question import Question
from drcli.saliency.recorded_episode import RecordedEpisode, record_episode
from drcli.saliency.saliency_page import page
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.repair import Model
from drcli.workers.cores import usable_cores


@dataclass(frozen=True)
class ExplainedStep:
    """What was found about one picture.

    Attributes:
        step: Its number in a trace.
        time_s: Simulated seconds since the start.
        progress: Percent of the lap.
        x: Where the car was, metres.
        y: The same.
        action: Index of the most likely action, null for continuous ones.
        steering_deg: Requested, left positive.
        speed_mps: Requested.
        strongest: For each method, row and column of the map's greatest value.
        greatest: For each method, this value.
        ninths: For each method, shares of the picture's ninths, from the top.
        lidar: How much each sector of the lidar matters, or null.
        picture: File with the maps, or null.
    """

    step: int
    time_s: float
    progress: float
    x: float
    y: float
    action: int | None
    steering_deg: float
    speed_mps: float
    strongest: dict[str, tuple[int, int]]
    greatest: dict[str, float]
    ninths: dict[str, list[list[float]]]
    lidar: list[float] | None
    picture: str | None


@dataclass(frozen=True)
class SaliencyReport:
    """An explained episode in numbers.

    Attributes:
        model: Prefix of the model, or path of the file.
        checkpoint: Name of the checkpoint; null for a file.
        world: The track.
        target: What the maps explain.
        unit: What the perturbation map counts.
        outcome: How the episode ended.
        progress: Percent of the lap.
        seconds: Simulated seconds.
        html: File of the page, or null.
        steps: The explained pictures.
        lap: For all steps: step, time_s, progress, steering_deg, speed_mps, and value, entropy and
            probabilities where the policy has them.
        notes: What a reader should know.
    """

    model: str
    checkpoint: str | None
    world: str
    target: str
    unit: str
    outcome: str
    progress: float
    seconds: float
    html: str | None
    steps: list[ExplainedStep]
    lap: dict[str, list[object]]
    notes: list[str] = field(default_factory=list)


def explain_checkpoint(
    settings: Settings,
    bucket: Bucket,
    prefix: str,
    choice: CheckpointChoice,
    question: Question,
) -> tuple[ExplainedEpisode, str]:
    """Drive and explain an episode; also returns the checkpoint's name.

    Raises:
        SettingsError: The model, checkpoint, or what is asked is missing.
        StorageError: Damaged checkpoint, or unreadable bucket.
    """
    if not keys.is_valid_prefix(prefix):
        raise SettingsError(
            f"{prefix!r} is not the prefix of a model.",
            remedy="List the models with `dr-list-models`; a policy's file is named by --model.",
        )
    name = take_choice(Model.of(settings.model, bucket, prefix), choice).name
    subject = open_policy(bucket, prefix, name)
    number = name.partition("_")[0]
    return _explain(f"{prefix}, checkpoint {number}", subject, settings, question), name


def explain_file(
    settings: Settings, path: Path, metadata: Path | None, question: Question
) -> ExplainedEpisode:
    """As `explain_checkpoint`, of a policy's file.

    Raises:
        SettingsError: It cannot be used, or lacks what is asked.
        NotAvailable: Its engine is not installed.
    """
    return _explain(path.name, open_policy_file(path, metadata), settings, question)


def write_page(path: Path, explained: ExplainedEpisode) -> None:
    """Callers check whether it may replace a file; raises SettingsError."""
    rewrite(path, page(explained).encode())


def write_stills(folder: Path, explained: ExplainedEpisode) -> list[str]:
    """Write a PNG per picture into a new or existing folder; raises SettingsError."""
    make_picture_folder(folder)
    written = []
    for number, step in enumerate(explained.chosen):
        path = folder / f"saliency-{explained.episode.rows[step].steps:04d}.png"
        rewrite(path, png_of(still(explained, number)))
        written.append(str(path))
    return written


def report_of(
    explained: ExplainedEpisode,
    model: str,
    checkpoint: str | None,
    html: Path | None,
    pictures: Sequence[str],
) -> SaliencyReport:
    episode = explained.episode
    return SaliencyReport(
        model=model,
        checkpoint=checkpoint,
        world=episode.world,
        target=explained.saliency.target,
        unit=explained.saliency.unit,
        outcome=episode.outcome,
        progress=episode.last.progress,
        seconds=episode.last.time_s,
        html=None if html is None else str(html),
        steps=[
            _step(explained, number, pictures[number] if pictures else None)
            for number in range(len(explained.chosen))
        ],
        lap=_lap(explained),
        notes=list(explained.notes),
    )


def _explain(
    title: str, subject: ExplainedPolicy, settings: Settings, question: Question
) -> ExplainedEpisode:
    threads = usable_cores(settings.run.train)
    torch.set_num_threads(1)  # as in an evaluation: more would round in another way
    episode = record_episode(subject, settings.run, seed=question.seed, threads=threads)
    torch.set_num_threads(threads)
    chosen = _chosen(episode, question)
    try:
        return explain_episode(
            title,
            subject,
            episode,
            chosen,
            methods=question.methods,
            target=question.target,
            spacing=question.spacing,
        )
    except NotExplainable as error:
        raise SettingsError(
            f"{title} cannot be explained: {error}",
            remedy="Choose another --target or --method; --target action with --method "
            "perturbation works for every policy.",
        ) from None


def _chosen(episode: RecordedEpisode, question: Question) -> list[int]:
    if not question.steps:
        return spread_steps(episode.steps, question.pictures)
    first, last = episode.rows[0].steps, episode.rows[-1].steps
    wrong = [step for step in question.steps if not first <= step <= last]
    if wrong:
        raise SettingsError(
            f"The episode has no step {wrong[0]}: {episode.outcome} after step {last}.",
            remedy=f"Choose steps from {first} to {last} with --steps, or another start.",
        )
    return sorted({step - first for step in question.steps})


def _step(explained: ExplainedEpisode, number: int, picture: str | None) -> ExplainedStep:
    step = explained.chosen[number]
    row, outputs, saliency = explained.episode.rows[step], explained.outputs, explained.saliency
    maps = {method: values[number].max(axis=0) for method, values in saliency.maps.items()}
    return ExplainedStep(
        step=row.steps,
        time_s=round(row.time_s, 3),
        progress=round(row.progress, 3),
        x=round(row.x, 4),
        y=round(row.y, 4),
        action=None if outputs.chosen is None else int(outputs.chosen[step]),
        steering_deg=round(float(outputs.steering_deg[step]), 3),
        speed_mps=round(float(outputs.speed_mps[step]), 3),
        strongest={method: place_of(values) for method, values in maps.items()},
        greatest={method: _short(float(values.max())) for method, values in maps.items()},
        ninths={
            method: [[round(share, 4) for share in band] for band in shares(values)]
            for method, values in maps.items()
        },
        lidar=None
        if saliency.lidar is None
        else [_short(value) for value in saliency.lidar[number].tolist()],
        picture=picture,
    )


def _lap(explained: ExplainedEpisode) -> dict[str, list[object]]:
    rows, outputs = explained.episode.rows, explained.outputs
    columns: dict[str, list[object]] = {
        "step": [row.steps for row in rows],
        "time_s": [round(row.time_s, 3) for row in rows],
        "progress": [round(row.progress, 3) for row in rows],
        "steering_deg": np.round(outputs.steering_deg, 3).tolist(),
        "speed_mps": np.round(outputs.speed_mps, 3).tolist(),
    }
    if outputs.value is not None:
        columns["value"] = [_short(value) for value in outputs.value.tolist()]
    if outputs.entropy is not None:
        columns["entropy"] = np.round(outputs.entropy, 4).tolist()
    if outputs.probabilities is not None:
        columns["probabilities"] = np.round(outputs.probabilities, 4).tolist()
    return columns


def _short(value: float) -> float:
    return float(f"{value:.6g}")
