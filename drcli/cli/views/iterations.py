"""Shows iterations in lines, tables and curves."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

from rich.table import Table
from rich.text import Text

from drcli.base.report import clock
from drcli.records.iteration import Laps

if TYPE_CHECKING:
    from drcli.records.iteration import IterationRecord

# Curves one line high, made of block characters.


T = TypeVar("T")

BLOCKS = "▁▂▃▄▅▆▇█"

NONE, SOME, ALL = "·", "◦", "●"


def curve(values: Sequence[float], width: int, *, top: float | None = None) -> str:
    """Numbers as heights, averaged down to `width` characters.

    From zero, or the least value if that is negative, to `top`, by default the greatest.
    """
    if not values:
        return ""
    means = [sum(part) / len(part) for part in _parts(values, width)]
    low = min(0.0, *means)
    span = (max(means) if top is None else top) - low
    if span <= 0:
        return BLOCKS[0] * len(means)
    last = len(BLOCKS) - 1
    heights = (round((mean - low) / span * last) for mean in means)
    return "".join(BLOCKS[max(0, min(last, height))] for height in heights)


def marks(completed: Sequence[float | None], width: int) -> str:
    """Marks of evaluations below a curve; the best of several is shown."""
    return "".join(_mark(part) for part in _parts(completed, width))


def _mark(completed: Sequence[float | None]) -> str:
    best = max((share for share in completed if share is not None), default=None)
    if best is None:
        return " "
    if best == 0:
        return NONE
    return ALL if best == 1 else SOME


def _parts(values: Sequence[T], width: int) -> list[Sequence[T]]:
    count = min(len(values), width)
    edges = [round(i * len(values) / count) for i in range(count + 1)] if count else []
    return [values[start:end] for start, end in pairwise(edges)]


CURVE_COLUMNS, LEAST_CURVE_COLUMNS = 54, 4
BESIDE_CURVE = 26
LEAST_COLUMNS = {
    "iter": 4,
    "steps": 9,
    "reward": 7,
    "progress": 8,
    "laps": 6,
    "eval": 9,
    "median": 7,
    "eval 2": 9,
    "stage": 5,
    "phase": 5,
    "entropy": 7,
    "losses": 12,
}
LONGEST_STAGE = 12
GAP = 2
RARE = ("eval 2", "stage", "phase")
OPTIONAL = ("phase", "losses", "entropy", "steps", "laps", "reward")
"""Narrow terminals omit them in this order."""


def line(record: "IterationRecord", *, verbose: bool = False) -> str:
    short = (
        f"{clock(record.elapsed_s):>7} iter {record.iteration:3d}  reward {record.mean_reward:6.1f}"
        f"  progress {record.mean_progress:3.0f} %  eval {evaluation(record)}"
    )
    if record.second_progress:
        short += f"  on {record.second_world} {second_evaluation(record)}"
    if record.stage:
        short += f"  stage {record.stage}"
    if record.phase:
        short += f"  phase {record.phase}"
    if not verbose:
        return short
    return (
        f"{short}  {record.total_steps} steps  laps {record.full_laps}/{record.episodes}  "
        f"entropy {_known(record.entropy, 3)}  "
        f"{_named_losses(record)}  {record.steps_per_s:.0f} steps/s  "
        f"{record.real_time_factor:.0f} x real time  {time_split(record)}"
    )


def table(records: "list[IterationRecord]", rows: int, columns: int) -> Table:
    lines = [_cells(record) for record in records]
    widths = {
        name: max(least, *(len(cells[name]) for cells in lines), 0)
        for name, least in LEAST_COLUMNS.items()
        if name not in RARE or any(cells[name] for cells in lines)
    }
    for name in (name for name in OPTIONAL if name in widths):
        if sum(widths.values()) + GAP * (len(widths) - 1) > columns:
            del widths[name]
    shown = Table(box=None, pad_edge=False, header_style="dim")
    sac = any(record.actor_loss is not None for record in records)
    for name, width in widths.items():
        header = {"losses": "loss a/c" if sac else "loss p/v"}.get(name, name)
        shown.add_column(header, min_width=width, justify="right", no_wrap=True)
    for cells in lines:
        shown.add_row(*(cells[name] for name in widths))
    for _ in range(rows - len(records)):
        shown.add_row()
    return shown


def curves(records: "list[IterationRecord]", columns: int) -> list[Text]:
    width = max(LEAST_CURVE_COLUMNS, min(CURVE_COLUMNS, columns - BESIDE_CURVE))
    progress = curve([record.mean_progress for record in records], width, top=100.0)
    reward = curve([record.mean_reward for record in records], width)
    sampled = [record.evaluation for record in records]
    shares = [None if laps is None else laps.clean / laps.driven for laps in sampled]
    newest = next((laps for laps in reversed(sampled) if laps is not None), None)
    last = records[-1] if records else None
    lines = (
        ("progress", progress, "green", f"{last.mean_progress:.1f} %" if last else ""),
        (
            "eval",
            marks(shares, width),
            "bold",
            f"{newest.clean} of {newest.driven} clean" if newest is not None else "",
        ),
        ("reward", reward, "cyan", f"{last.mean_reward:.1f}" if last else ""),
    )
    return [
        Text.assemble((f"{name:9}", "dim"), (f"{drawn:{width}}", style), "  ", value)
        for name, drawn, style, value in lines
    ]


def time_split(record: "IterationRecord") -> str:
    return (
        f"drive {record.drive_s:.1f} s  learn {record.learn_s:.1f} s  "
        f"exchange {record.exchange_s:.1f} s"
    )


def last_step(record: "IterationRecord") -> str:
    """How far the policy moved, SAC's temperature, or the student's distance from its teacher."""
    if record.imitation_loss is not None:
        return f"imitation loss {record.imitation_loss:.4f}"
    if record.alpha is not None:
        return f"alpha {record.alpha:.4f}"
    return f"KL {_known(record.kl, 4)}"


def _cells(record: "IterationRecord") -> dict[str, str]:
    second = _second(record)
    return {
        "iter": str(record.iteration),
        "steps": f"{record.total_steps:,}",
        "reward": f"{record.mean_reward:.1f}",
        "progress": f"{record.mean_progress:.1f} %",
        "laps": f"{record.full_laps}/{record.episodes}",
        "eval": _first(record),
        "median": _median(record.evaluation),
        "eval 2": _evaluated(record.second_progress, second) if second is not None else "",
        "stage": record.stage[:LONGEST_STAGE],
        "phase": record.phase,
        "entropy": _known(record.entropy, 2),
        "losses": _losses(record),
    }


def _losses(record: "IterationRecord") -> str:
    """Of policy and value, actor and critic, or student."""
    if record.imitation_loss is not None:
        return f"imit {record.imitation_loss:.3f}"
    if record.actor_loss is not None and record.critic_loss is not None:
        return f"{record.actor_loss:.3f}/{record.critic_loss:.2f}"
    return f"{_known(record.surrogate_loss, 3)}/{_known(record.value_loss, 2)}"


def _named_losses(record: "IterationRecord") -> str:
    if record.imitation_loss is not None:
        return last_step(record)
    if record.actor_loss is not None and record.critic_loss is not None:
        losses = f"actor loss {record.actor_loss:.4f}  critic loss {record.critic_loss:.4f}"
    else:
        policy, value = _known(record.surrogate_loss, 4), _known(record.value_loss, 4)
        losses = f"policy loss {policy}  value loss {value}"
    return f"{losses}  {last_step(record)}"


def _known(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def evaluation(record: "IterationRecord") -> str:
    if record.phase == "teacher":
        return _first(record)
    return _with_median(record.evaluation_progress, record.evaluation)


def second_evaluation(record: "IterationRecord") -> str:
    return _with_median(record.second_progress, _second(record))


def _second(record: "IterationRecord") -> Laps | None:
    progress = record.second_progress
    return Laps(len(progress), record.second_lap_s) if progress else None


def _first(record: "IterationRecord") -> str:
    """A teacher has none: it sees no camera."""
    if record.phase == "teacher":
        return "-"
    return _evaluated(record.evaluation_progress, record.evaluation)


def _with_median(progress: Sequence[float], laps: Laps | None) -> str:
    clean = "" if laps is None else " clean"
    return f"{_evaluated(progress, laps)}{clean} {_median(laps)}".rstrip()


def _evaluated(progress: Sequence[float], laps: Laps | None) -> str:
    if laps is None:
        return "..."
    return f"{sum(progress) / len(progress):.0f} % {laps.clean}/{laps.driven}"


def _median(laps: Laps | None) -> str:
    return f"{laps.median_s:.2f} s" if laps is not None and laps.median_s is not None else ""
