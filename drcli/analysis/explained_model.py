"""Pictures of what moves the action of a model."""

from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.report.graphs import Picture
from drcli.base.installation import lazy_imports
from drcli.config.settings import Settings
from drcli.config.value_types import parse_checkpoint
from drcli.model.model_store import ModelStore
from drcli.view.saliency.saliency_options import FAST_SPACING, SaliencyOptions

if TYPE_CHECKING:
    from drcli.view.saliency.explained_episode import ExplainedEpisode

with lazy_imports():
    from drcli.view.saliency import explain_model, explanation_pictures
    from drcli.view.video import overlay

SOME_STEPS = SaliencyOptions(pictures=6, spacing=FAST_SPACING)
_LIKELY = 3


def explained_pictures(
    settings: Settings, model: ModelStore, question: SaliencyOptions = SOME_STEPS
) -> tuple[Picture, ...]:
    """Drive an episode with a model's best checkpoint, and explain some of its steps.

    Raises:
        SettingsError: There is no such checkpoint, or it cannot be explained.
        StorageError: The bucket cannot be read.
    """
    best = parse_checkpoint("best")
    explained, name = explain_model.explain_checkpoint(settings, model, best, question)
    number = name.partition("_")[0]
    steps = range(len(explained.chosen))
    return tuple(_picture(explained, step, f"Checkpoint {number}.") for step in steps)


def _picture(explained: "ExplainedEpisode", number: int, title: str) -> Picture:
    parts = explanation_pictures.pictures_of(explained, number)
    tiles = list(parts.values())
    if len(tiles) % 2:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[first : first + 2]) for first in range(0, len(tiles), 2)]
    texts = (
        title,
        explanation_pictures.moment(explained, number),
        explanation_pictures.decision(explained, number),
    )
    finding = explanation_pictures.finding(explained, number)
    caption = f"{' '.join(texts)} {finding} Row by row: {', '.join(parts)}."
    probabilities = explained.outputs.probabilities
    numbers = {}
    if probabilities is not None:
        shares = enumerate(probabilities[explained.chosen[number]].tolist())
        likely = sorted(shares, key=lambda pair: -pair[1])[:_LIKELY]
        numbers = {f"action {action}": share for action, share in likely}
    return Picture(overlay.encoded(np.vstack(rows), "PNG"), caption, numbers)
