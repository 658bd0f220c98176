"""Which checkpoints of a training stay besides the newest ones and the best.

Milestones and every n-th checkpoint stay, up to a size. Beyond it, those of every n-th go first, so
that the rest stays evenly spread over the training; then the first lap, the three laps, and last of
all the fastest lap.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.milestone_record import Milestones


@dataclass(frozen=True)
class KeepRules:
    """What stays.

    Attributes:
        milestones: Whether milestones stay: DR_TRAIN_KEEP_MILESTONES.
        every: Numbers that are multiples of this stay; 0 for none: DR_TRAIN_KEEP_EVERY.
        max_bytes: Largest size of everything that these rules keep; 0 for no limit:
            DR_TRAIN_KEEP_MAX_MB.
    """

    milestones: bool = True
    every: int = 0
    max_bytes: int = 0

    def spaces(self, name: CheckpointName) -> bool:
        """Whether this is an n-th checkpoint; the first one, which has learned nothing, is not."""
        return self.every > 0 and name.number > 0 and name.number % self.every == 0


KEEP_ALL_MARKED = KeepRules()
"""Keeps the milestones, and what was kept as every n-th, whatever its size."""


@dataclass(frozen=True)
class Kept:
    """What stays: the checkpoints, and which of them stay as every n-th."""

    names: frozenset[CheckpointName]
    spaced: tuple[str, ...]


def kept_besides(
    sizes: Mapping[CheckpointName, int],
    always: Collection[CheckpointName],
    milestones: Milestones,
    rules: KeepRules,
    newest: CheckpointName,
) -> Kept:
    """What the rules keep besides those that always stay.

    Args:
        sizes: All checkpoints that are there, each with the size of its files in bytes.
        always: Those that stay whatever the rules say: the newest ones and the best.
        milestones: The milestones, and what was kept as every n-th until now. That stays when
            DR_TRAIN_KEEP_EVERY changes.
        rules: What stays.
        newest: The newest checkpoint.
    """
    known = {checkpoint_name(name) for name in milestones.spaced}
    spaced = {name for name in sizes if name in known or rules.spaces(name)}
    reached = [m.name for _, m in milestones.reached()] if rules.milestones else []
    order = [*_by_crowding(spaced - set(reached), newest), *dict.fromkeys(_last_first(reached))]
    extra = [name for name in order if name in sizes and name not in always]
    if rules.max_bytes:
        total = sum(sizes[name] for name in extra)
        while extra and total > rules.max_bytes:
            gone = extra.pop(0)
            spaced.discard(gone)
            total -= sizes[gone]
    return Kept(frozenset(extra), tuple(str(name) for name in sorted(spaced)))


def _last_first(reached: list[CheckpointName]) -> list[CheckpointName]:
    """Each once, at the place of its last milestone: the fastest lap is the last to go."""
    return list(reversed(list(dict.fromkeys(reversed(reached)))))


def _by_crowding(names: Iterable[CheckpointName], newest: CheckpointName) -> list[CheckpointName]:
    """In the order in which they go: each time the one whose neighbours are closest to each other.

    Of equally crowded ones, the oldest goes first.
    """
    left = sorted(names)
    order = []
    while left:
        ends = [0, *(name.number for name in left), newest.number]
        gaps = [ends[at + 2] - ends[at] for at in range(len(left))]
        order.append(left.pop(gaps.index(min(gaps))))
    return order
