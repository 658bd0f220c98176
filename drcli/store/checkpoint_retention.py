"""Which checkpoints of a training stay besides the newest and the best.

Milestones and every n-th, up to a size. Beyond it, every n-th go first, so that the rest stays
evenly spread; then first lap, three laps, and last the fastest lap.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.milestone_record import Milestones


@dataclass(frozen=True)
class KeepRules:
    """What stays.

    Attributes:
        milestones: DR_TRAIN_KEEP_MILESTONES.
        every: DR_TRAIN_KEEP_EVERY; 0 for none.
        max_bytes: DR_TRAIN_KEEP_MAX_MB; 0 for no limit.
    """

    milestones: bool = True
    every: int = 0
    max_bytes: int = 0

    def spaces(self, name: CheckpointName) -> bool:
        """Whether it is an n-th; the first has learned nothing."""
        return self.every > 0 and name.number > 0 and name.number % self.every == 0


KEEP_ALL_MARKED = KeepRules()


@dataclass(frozen=True)
class Kept:
    names: frozenset[CheckpointName]
    spaced: tuple[str, ...]


def kept_besides(
    sizes: Mapping[CheckpointName, int],
    always: Collection[CheckpointName],
    milestones: Milestones,
    rules: KeepRules,
    newest: CheckpointName,
) -> Kept:
    """What the rules keep besides those that `always` stay; sizes in bytes."""
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
    """At the place of its last milestone: the fastest lap goes last."""
    return list(reversed(list(dict.fromkeys(reversed(reached)))))


def _by_crowding(names: Iterable[CheckpointName], newest: CheckpointName) -> list[CheckpointName]:
    """Next goes the one with the closest neighbours; of equals, the oldest."""
    left = sorted(names)
    order = []
    while left:
        ends = [0, *(name.number for name in left), newest.number]
        gaps = [ends[at + 2] - ends[at] for at in range(len(left))]
        order.append(left.pop(gaps.index(min(gaps))))
    return order
