"""Schedules of faults as data: each fault with the iteration after which it comes.

A schedule is a text with a line for each fault, such as `12 stop process=trainer for_s=4.0`, so
that a failing one can be printed, shortened, and replayed. Iterations, not seconds, say when:
otherwise a slow machine would get other faults than a fast one.
"""

import random
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

Value = str | float | int

_LINE = re.compile(r"(\d+) +([a-z_]+)((?: +[a-z_]+=[^ =]+)*)")

WORKERS = ("supervisor", "trainer", "sim-0", "sim-1")
OBJECTS = (
    *("pointer", "scores", "history", "metrics", "learner", "record", "weights", "optimizer"),
    *("manifest", "part", "evaluation", "lease", "status", "metadata", "hyperparameters", "note"),
)
"""Objects that a fault may damage. Traces are not among them: only they say what was driven, so a
damaged one cannot be reconstructed."""

WRITTEN = {
    "trainer": (
        *("weights", "record", "pointer", "scores", "optimizer", "graph", "history", "learner"),
    ),
    "sim-0": ("part", "manifest", "trace", "metrics", "evaluation"),
    "supervisor": ("lease",),
}
"""Who writes what; `crash` kills the writer at that moment."""

DAMAGES = ("empty", "half", "bit", "zeros", "lost")


@dataclass(frozen=True)
class Fault:
    """A fault: after which iteration it comes, what it is, and its parameters."""

    after: int
    kind: str
    values: dict[str, Value] = field(default_factory=dict)

    def __str__(self) -> str:
        words = [f"{name}={value}" for name, value in self.values.items()]
        return " ".join([str(self.after), self.kind, *words])

    def number(self, name: str, default: float = 0.0) -> float:
        """A parameter that is a number."""
        return float(self.values.get(name, default))

    def text(self, name: str) -> str:
        """A parameter that is a word."""
        return str(self.values[name])


def parse(text: str) -> list[Fault]:
    """The faults of a schedule; empty lines and lines that begin with # are left out.

    Raises:
        ValueError: A line is no fault.
    """
    faults = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.strip()
        if not words or words.startswith("#"):
            continue
        found = _LINE.fullmatch(words)
        if found is None or found[2] not in KINDS:
            raise ValueError(f"Line {number} is no fault: {line!r}.")
        pairs = (word.split("=", 1) for word in found[3].split())
        faults.append(Fault(int(found[1]), found[2], {name: _value(x) for name, x in pairs}))
    return faults


def text_of(faults: Iterable[Fault]) -> str:
    """The schedule as text."""
    return "".join(f"{fault}\n" for fault in faults)


def _value(text: str) -> Value:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


SHORT = """
1 kill process=trainer
2 damage object=metrics how=half seed=1
2 errors code=internal share=0.3 for_s=3
3 clock ahead_s=-600
3 cut part=answer share=0.3 for_s=2
4 damage object=history how=bit seed=3
4 kill process=supervisor
5 stop process=server for_s=2
6 kill process=sim-0
7 gone cloud=local
8 kill process=server
8 damage object=pointer how=empty seed=5
"""
"""The form in CI, for one simulation worker."""

Values = dict[str, Value]


def _seconds(rng: random.Random, least: float, most: float) -> float:
    return round(rng.uniform(least, most), 1)


def _kill(rng: random.Random) -> Values:
    return {"process": rng.choice([*WORKERS, "server", "watcher"])}


def _crash(rng: random.Random) -> Values:
    process = rng.choice(["trainer", "trainer", "sim-0", "sim-0", "supervisor"])
    on, when = rng.choice(WRITTEN[process]), rng.choice(["before", "after"])
    return {"on": on, "when": when, "who": rng.choice([process, process, "everybody"])}


def _stop(rng: random.Random) -> Values:
    return {"process": rng.choice([*WORKERS, "server"]), "for_s": _seconds(rng, 0.5, 12.0)}


def _shortly(rng: random.Random) -> Values:
    return {"for_s": _seconds(rng, 0.5, 10.0)}


def _errors(rng: random.Random) -> Values:
    share = rng.choice([0.1, 0.3, 1.0])
    longest = 5.0 if share == 1.0 else 10.0
    code = rng.choice(["internal", "busy", "slow_down"])
    return {"code": code, "share": share, "for_s": _seconds(rng, 1.0, longest)}


def _slow(rng: random.Random) -> Values:
    return {"latency_s": rng.choice([0.2, 1.0, 3.0]), "for_s": _seconds(rng, 2.0, 15.0)}


def _narrow(rng: random.Random) -> Values:
    return {"bytes_per_s": rng.choice([50_000, 300_000]), "for_s": _seconds(rng, 2.0, 10.0)}


def _cut(rng: random.Random) -> Values:
    part = rng.choice(["request", "answer"])
    return {"part": part, "share": rng.choice([0.2, 0.5]), "for_s": _seconds(rng, 1.0, 8.0)}


def _damage(rng: random.Random) -> Values:
    return {"object": rng.choice(OBJECTS), "how": rng.choice(DAMAGES), "seed": rng.randrange(1000)}


def _memory(rng: random.Random) -> Values:
    return {"process": rng.choice(["trainer", "sim-0", "sim-1"]), "more_mb": rng.choice([1, 50])}


def _clock(rng: random.Random) -> Values:
    return {"ahead_s": rng.choice([-600, -90, -5, 0, 5, 90, 600])}


def _gone(rng: random.Random) -> Values:
    return {"cloud": rng.choice(["remote", "local"])}


def _nothing(_: random.Random) -> Values:
    return {}


KINDS: dict[str, tuple[Callable[[random.Random], Values], float]] = {
    "kill": (_kill, 4.0),
    "crash": (_crash, 4.0),
    "stop": (_stop, 3.0),
    "refuse": (_shortly, 1.5),
    "silence": (_shortly, 1.0),
    "errors": (_errors, 2.0),
    "slow": (_slow, 1.0),
    "narrow": (_narrow, 0.5),
    "cut": (_cut, 2.0),
    "old_lists": (_shortly, 1.0),
    "damage": (_damage, 4.0),
    "fill": (_shortly, 0.7),
    "quota": (_shortly, 0.7),
    "memory": (_memory, 0.7),
    "clock": (_clock, 1.5),
    "notice": (_nothing, 1.0),
    "terminate": (_nothing, 1.0),
    "gone": (_gone, 1.5),
    "second_owner": (_nothing, 0.7),
}
"""The kinds of faults: what chooses the parameters, and how often they come.

`fill` needs root, for a disk of its own; `kill server` and what damages objects happen in the
bucket, all others on the machine or in its network.
"""


NETWORK = ("crash", "refuse", "silence", "errors", "slow", "narrow", "cut", "old_lists", "quota")
"""Kinds that need the proxy, so a machine whose bucket is elsewhere."""


MOST_AT_HOME = 8
"""Faults in a row that a machine gets whose bucket is on its own disk."""


def random_schedule(
    seed: int, faults: int, *, kinds: Iterable[str] = KINDS, first: int = 1
) -> list[Fault]:
    """Choose faults: one after each iteration or two, now and then two at the same time.

    Every kind comes once before any comes again, as far as there are enough faults. A machine
    whose bucket is on its own disk gets no faults of the network.
    """
    rng = random.Random(seed)
    names = [name for name in KINDS if name in set(kinds)]
    fresh = rng.sample(names, len(names))
    after, schedule, at_home = first, list[Fault](), 0
    while len(schedule) < faults:
        possible = [name for name in names if not at_home or name not in NETWORK]
        kind = next((name for name in fresh if name in possible), None)
        if at_home >= MOST_AT_HOME and "gone" in names:
            kind = "gone"
        elif kind is None:
            kind = rng.choices(possible, [KINDS[name][1] for name in possible])[0]
        if kind in fresh:
            fresh.remove(kind)
        values = KINDS[kind][0](rng)
        if kind == "gone":
            values = {"cloud": "remote"} if at_home else values
            at_home = 0
        at_home += bool(at_home) or values == {"cloud": "local"}
        schedule.append(Fault(after, kind, values))
        after += rng.choice([0, 1, 1, 1, 2])
    return schedule


def crash_points(first: int = 1) -> list[Fault]:
    """A crash before and after each object that a training writes, one after the other."""
    points = [
        {"on": on, "when": when, "who": process}
        for process, objects in WRITTEN.items()
        for on in objects
        for when in ("before", "after")
    ]
    return [Fault(first + 2 * n, "crash", dict(values)) for n, values in enumerate(points)]
