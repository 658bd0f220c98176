"""An episode with explanations of its steps."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from drcli.learn.policy import Observation
from drcli.saliency.maps import SaliencyMaps, saliency_maps
from drcli.saliency.perturbation import lidar_sectors
from drcli.saliency.policy_outputs import ExplainedPolicy, PolicyOutputs, outputs_of
from drcli.saliency.question import FINE_SPACING, METHODS, Method, Target
from drcli.saliency.recorded_episode import RecordedEpisode

ROWS, COLUMNS = ("far", "middle", "near"), ("left", "centre", "right")
"""Of the ninths of a picture."""

_STEPS_AT_A_TIME = 128


@dataclass(frozen=True, eq=False)
class ExplainedEpisode:
    """An episode and its explanation.

    Attributes:
        title: Such as `model, checkpoint 12`.
        outputs: For every step.
        chosen: Explained steps, from 0. Length k.
        saliency: Of these.
    """

    title: str
    subject: ExplainedPolicy
    episode: RecordedEpisode
    outputs: PolicyOutputs
    chosen: tuple[int, ...]
    saliency: SaliencyMaps
    notes: tuple[str, ...] = ()


def explain_episode(
    title: str,
    subject: ExplainedPolicy,
    episode: RecordedEpisode,
    chosen: Sequence[int],
    *,
    methods: Collection[Method] = METHODS,
    target: Target = "action",
    spacing: int = FINE_SPACING,
) -> ExplainedEpisode:
    """Raises NotExplainable as `saliency_maps`, ValueError for steps that do not exist."""
    wrong = [step for step in chosen if not 0 <= step < episode.steps]
    if wrong:
        raise ValueError(f"The episode has no step {wrong[0]}: it has {episode.steps}.")
    index = list(chosen)
    saliency = saliency_maps(
        subject,
        episode.frames[index],
        episode.scans[index],
        episode.states[index],
        methods=methods,
        target=target,
        spacing=spacing,
    )
    outputs = _all_outputs(subject, episode)
    notes = _notes(subject, episode, methods, saliency)
    return ExplainedEpisode(title, subject, episode, outputs, tuple(index), saliency, notes)


def spread_steps(steps: int, count: int) -> list[int]:
    return sorted({round(place) for place in np.linspace(0, steps - 1, min(count, steps))})


def shares(values: np.ndarray) -> list[list[float]]:
    """How much of a map lies in each ninth, from the top."""
    total = float(values.sum(dtype=np.float64))
    if not total > 0.0:
        return [[0.0] * 3 for _ in range(3)]
    return [
        [float(part.sum(dtype=np.float64)) / total for part in np.array_split(band, 3, axis=1)]
        for band in np.array_split(values, 3, axis=0)
    ]


def place_of(values: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(values.argmax()), values.shape)
    return int(row), int(column)


def sector_bearings(subject: ExplainedPolicy) -> list[tuple[float, float]]:
    """Of `SaliencyMaps.lidar`, degrees to the left."""
    bearings = np.degrees(subject.sensors.lidar_model.bearings_rad)
    half = (bearings[1] - bearings[0]) / 2.0
    return [
        (float(part[0] - half), float(part[-1] + half))
        for part in np.array_split(bearings, lidar_sectors(subject))
    ]


def _all_outputs(subject: ExplainedPolicy, episode: RecordedEpisode) -> PolicyOutputs:
    parts = [
        outputs_of(
            subject,
            Observation.of_arrays(episode.frames[part], episode.scans[part], episode.states[part]),
        )
        for part in (
            slice(begin, begin + _STEPS_AT_A_TIME)
            for begin in range(0, episode.steps, _STEPS_AT_A_TIME)
        )
    ]
    return PolicyOutputs.joined(parts)


def _notes(
    subject: ExplainedPolicy,
    episode: RecordedEpisode,
    methods: Collection[Method],
    saliency: SaliencyMaps,
) -> tuple[str, ...]:
    notes = list(episode.notes)
    if set(methods) - set(saliency.maps):
        notes.append(
            "This policy runs in an engine without gradients, so it has a perturbation map only."
        )
    if subject.sensors.lidar is not None and saliency.lidar is None:
        notes.append("Only --method perturbation explains what the lidar contributes.")
    if saliency.outputs.value is None:
        notes.append("There is no critic in the file of a policy, so no value is shown.")
    elif subject.policy.spec.state_dims:
        notes.append(
            "The critic sees the state of the car instead of the picture (hyperparameter critic)."
        )
    return tuple(notes)
