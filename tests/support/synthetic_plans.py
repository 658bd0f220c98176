"""Plans of trainings that were never driven: healthy ones of many kinds, and ones with a fault.

A plan is drawn from a seed: track, actions, workers, length, learning speed, noise, reward, starts,
evaluations. Nothing in it knows how findings are made.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Plan:
    """What a run is like. `None` means: as drawn."""

    seed: int
    style: str = "driver"  # steers by the track; "dice" draws actions without looking at it
    iterations: int = 30
    episodes: int = 20
    workers: int = 1
    length_m: float = 18.0
    shape: str = "blob"
    clockwise: bool = False
    waypoints: int = 120
    actions: tuple[tuple[float, float], ...] = ()
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    start: str = "spread"
    first: float = 8.0
    final: float = 85.0
    speed_of_learning: float = 0.3
    wobble: float = 0.06  # chance in the level of an iteration, as a share of it
    early_random: float = 0.9
    late_random: float = 0.3
    reward: str = "centre"
    evaluations: int = 5
    lead: float = 10.0  # how far evaluations are ahead
    off: float = 0.04
    hyper: dict[str, Any] = field(default_factory=dict)
    level: Callable[["Plan", np.random.Generator], np.ndarray] | None = None
    evaluation_level: Callable[["Plan", np.ndarray, np.random.Generator], np.ndarray] | None = None
    dead: tuple[int, ...] = ()
    side: int = 0
    swing: tuple[float, float] | None = None  # degrees, period in steps
    slowing: float = 0.0
    cut: float = 0.0
    only: tuple[int, float] | None = None  # action and its share
    columns: int = 19

    @property
    def continuous(self) -> bool:
        return self.low is not None


def healthy(seed: int) -> Plan:
    """A training without a fault."""
    rng = np.random.default_rng(seed)
    angles = int(rng.integers(2, 4)) * 2 + 1 if rng.random() < 0.8 else int(rng.integers(3, 8))
    most = float(rng.choice([20, 25, 30]))
    speeds = np.sort(
        rng.choice([0.7, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0], int(rng.integers(1, 4)), False)
    )
    grid = tuple((float(a), float(v)) for a in np.linspace(-most, most, angles) for v in speeds)
    continuous = rng.random() < 0.25
    iterations = round(math.exp(rng.uniform(math.log(5), math.log(200))))
    episodes = int(rng.choice([20, 20, 20, 10, 12, 30, 40]))
    if iterations * episodes > 1500:
        episodes = 10
    slow = float(rng.uniform(0.5, 1.2))
    return Plan(
        seed=seed,
        style="dice" if rng.random() < 0.3 else "driver",
        iterations=iterations,
        episodes=episodes,
        workers=int(rng.choice([1, 1, 1, 2, 3])),
        length_m=float(rng.uniform(8, 40 if iterations < 60 else 20)),
        shape=str(rng.choice(["blob", "blob", "oval", "circle"])),
        clockwise=bool(rng.random() < 0.4),
        waypoints=int(rng.integers(50, 240)),
        actions=() if continuous else grid,
        low=(-most, slow) if continuous else None,
        high=(most, slow * float(rng.uniform(1.5, 4))) if continuous else None,
        start=str(rng.choice(["spread", "spread", "fixed", "random"])),
        first=float(rng.uniform(4, 15)),
        final=float(rng.choice([rng.uniform(55, 80), rng.uniform(80, 99)])),
        speed_of_learning=float(rng.uniform(0.15, 0.6)),
        wobble=float(rng.uniform(0.02, 0.1)),
        early_random=float(rng.uniform(0.7, 1.0)),
        late_random=float(rng.uniform(0.1, 0.6)),
        reward=str(
            rng.choice(["centre", "bands", "progress", "speed", "squared", "constant", "mixed"])
        ),
        evaluations=int(rng.choice([0, 2, 5])),
        lead=float(rng.uniform(-4, 25)),
        off=float(rng.uniform(0.0, 0.08)),
        hyper={
            "batch_size": int(rng.choice([64, 64, 128, 32])),
            "lr": float(rng.choice([0.0003, 0.0003, 0.001, 0.0001])),
            "discount_factor": float(rng.choice([0.95, 0.99, 0.999, 0.9])),
            "beta_entropy": 0.01,
        },
        columns=int(rng.choice([19, 17])),
    )


def collapsed(seed: int) -> tuple[Plan, int]:
    """It falls apart at an iteration and stays so."""
    plan, rng = _long(seed)
    at = int(rng.integers(plan.iterations // 3 + 2, plan.iterations - 3))
    ramp, low = int(rng.choice([0, 0, 1, 2])), float(rng.uniform(2, 15))

    def level(plan: Plan, rng: np.random.Generator) -> np.ndarray:
        values = learning(plan, rng)
        for n in range(at, plan.iterations):
            part = min(1.0, (n - at + 1) / (ramp + 1))
            values[n] = values[n] * (1 - part) + low * part * rng.uniform(0.8, 1.2)
        return values

    return replace(plan, level=level, final=max(plan.final, 55.0), speed_of_learning=0.2), at


def dead_action(seed: int) -> tuple[Plan, int]:
    """One action is never taken, or no more after a while."""
    plan, rng = _discrete(seed)
    number = int(rng.integers(len(plan.actions)))
    return replace(plan, dead=(number,), late_random=max(0.3, plan.late_random)), number


def slow_reward(seed: int) -> Plan:
    """Slow driving earns more, in one of several ways."""
    plan, rng = _discrete(seed, several_speeds=True)
    kind = str(rng.choice(["inverse", "brake", "slowing"]))
    if kind == "slowing":
        return replace(plan, reward="constant", slowing=float(rng.uniform(1.5, 4.0)))
    return replace(plan, reward=kind, slowing=float(rng.choice([0.0, 1.0, 2.0])))


def one_sided(seed: int) -> Plan:
    """It steers to one side only."""
    plan, rng = _long(seed)
    side = int(rng.choice([-1, 1]))
    shape = "blob"
    if rng.random() < 0.3:  # the wrong side of a track that bends to one side only
        shape, plan = "oval", replace(plan, clockwise=side > 0)
    return replace(plan, side=side, shape=shape, final=float(rng.uniform(20, 70)))


def small_batch(seed: int) -> Plan:
    """Chance decides what it learns."""
    plan, rng = _long(seed)
    few = rng.random() < 0.5
    hyper = {**plan.hyper, "batch_size": int(rng.choice([4, 8, 16, 32]))}
    return replace(
        plan,
        hyper=hyper,
        episodes=int(rng.choice([2, 4, 5])) if few else plan.episodes,
        workers=1 if few else plan.workers,
        wobble=float(rng.uniform(0.4, 0.7)),
        final=float(rng.uniform(30, 70)),
        iterations=max(plan.iterations, 20),
    )


def over_trained(seed: int) -> Plan:
    """It is best in the middle and slowly becomes worse."""
    plan, rng = _long(seed)
    best = float(rng.uniform(0.4, 0.6))
    loss = float(rng.uniform(0.3, 0.38))

    def level(plan: Plan, rng: np.random.Generator) -> np.ndarray:
        values = learning(plan, rng)
        part = np.arange(plan.iterations) / (plan.iterations - 1)
        return values * (1 - loss * np.clip((part - best) / (1 - best), 0, 1))

    def evaluated(plan: Plan, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.clip(values + plan.lead, 0, 100)

    return replace(
        plan,
        iterations=max(40, plan.iterations),
        episodes=20,
        final=float(rng.uniform(80, 99)),
        level=level,
        evaluation_level=evaluated,
        speed_of_learning=0.2,
        lead=min(plan.lead, 0.0),
        wobble=min(plan.wobble, 0.05),
    )


def snaking(seed: int) -> Plan:
    """The steering swings from side to side."""
    plan, rng = _long(seed)
    return replace(
        plan, swing=(float(rng.uniform(15, 30)), float(rng.choice([2, 4, 6, 8, 10, 14])))
    )


def cutting(seed: int) -> Plan:
    """It drives on with wheels off the track."""
    plan, rng = _long(seed)
    return replace(plan, cut=float(rng.uniform(0.2, 0.5)), final=float(rng.uniform(60, 99)))


def no_exploration(seed: int) -> Plan:
    """It settled on one action before it could drive."""
    plan, rng = _discrete(seed)
    number = int(rng.integers(len(plan.actions)))
    return replace(
        plan,
        only=(number, float(rng.uniform(0.94, 1.0))),
        final=float(rng.uniform(10, 35)),
        evaluations=0,
        lead=0.0,
    )


def evaluation_behind(seed: int) -> Plan:
    """Evaluations get far less of the lap than training episodes."""
    plan, rng = _long(seed)
    gap = float(rng.uniform(0.35, 0.8))

    def evaluated(plan: Plan, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return values * (1 - gap)

    return replace(
        plan,
        evaluations=int(rng.choice([2, 5])),
        evaluation_level=evaluated,
        final=float(rng.uniform(70, 98)),
        speed_of_learning=0.25,
    )


def under_trained(seed: int) -> Plan:
    """It was stopped long before it could drive."""
    plan = healthy(seed)
    rng = np.random.default_rng(seed + 1)
    return replace(
        plan,
        iterations=int(rng.integers(8, 20)),
        episodes=20,
        first=5.0,
        final=float(rng.uniform(25, 45)),
        speed_of_learning=1.0,
        wobble=0.04,
        evaluations=0,
    )


def _long(seed: int) -> tuple[Plan, np.random.Generator]:
    """A training that is long enough to show a fault."""
    plan = healthy(seed)
    rng = np.random.default_rng(seed + 1)
    iterations = max(15, min(plan.iterations, 80))
    return replace(plan, iterations=iterations, episodes=max(10, plan.episodes)), rng


def _discrete(seed: int, several_speeds: bool = False) -> tuple[Plan, np.random.Generator]:
    plan, rng = _long(seed)
    if plan.actions and (not several_speeds or len({v for _, v in plan.actions}) > 1):
        return plan, rng
    grid = tuple((float(a), v) for a in (-30, -15, 0, 15, 30) for v in (1.0, 2.0))
    return replace(plan, actions=grid, low=None, high=None), rng


def learning(plan: Plan, rng: np.random.Generator) -> np.ndarray:
    """Mean progress of the iterations, percent."""
    part = np.arange(plan.iterations) / max(1, plan.iterations - 1)
    tau = plan.speed_of_learning
    rise = (1 - np.exp(-part / tau)) / (1 - math.exp(-1 / tau))
    values = plan.first + (plan.final - plan.first) * rise
    return np.asarray(np.clip(values * (1 + plan.wobble * rng.standard_normal(len(part))), 2, 99))
