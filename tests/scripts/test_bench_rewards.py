"""What scripts/bench/rewards.py makes of its measurements, and that its reward functions work."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from drsim.episode.load_reward import load_reward_function
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "bench"


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("rewards")


def test_a_style_without_laps_and_scales_that_differ_miss_their_bars(bench: ModuleType) -> None:
    def results(style: str, factor: float, *steps: int | None) -> list[object]:
        return [
            bench.Result(bench.Case(style, factor, seed), count) for seed, count in enumerate(steps)
        ]

    figures = bench.report(
        [
            *results("heading", 1.0, 900, None, 1_100),
            *results("penalties", 1.0, None, None, 50),
            *results("shipped", 1.0, 1_000, 2_000, 3_000),
            *results("shipped", 100.0, 4_000, 4_000, 100),
        ],
        ["shapely_corridor: shapely is not installed"],
    )

    assert figures["medians"]["heading"] == 1_100
    assert figures["medians"]["penalties"] is None
    assert figures["styles_that_lap"] == ["heading"]
    assert figures["scales_ratio"] == 2.0
    assert [line.split(":")[0] for line in figures["missed"]] == [
        "penalties",
        "scales",
        "shapely_corridor",
    ]


def test_what_was_measured_is_not_measured_again(bench: ModuleType, tmp_path: Path) -> None:
    result = bench.Result(bench.Case("heading", 0.001, 3), None)

    bench.append(tmp_path / "results", result)

    assert bench.read(tmp_path / "results") == {result.case: result}


@pytest.mark.parametrize("path", sorted((SCRIPTS / "reward_styles").glob("*.py")), ids=str)
def test_each_style_pays_on_a_drive(bench: ModuleType, path: Path) -> None:
    missing = bench.missing_package(path.stem)
    if missing is not None:
        pytest.skip(f"{missing} is not installed")
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=load_reward_function(path),
        num_threads=1,
    )
    simulation.reset(np.array([0]), np.array([0.0]))

    rewards = [float(simulation.step(np.array([0.0]), np.array([1.5])).reward[0]) for _ in range(8)]

    simulation.close()
    assert max(rewards) > 0.0
