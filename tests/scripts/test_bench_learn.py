"""What scripts/bench/learn.py makes of its measurements."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from drcli.learn.rollout_buffer import Rollout

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "bench"


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("learn")


def test_a_ratio_is_the_median_of_what_was_measured_in_the_same_rounds(bench: ModuleType) -> None:
    # The machine is ten times slower in the second round: the pairs do not notice.
    ratios = bench.pairs([200.0, 20.0, 330.0], [100.0, 10.0, 110.0])

    report = bench.report([bench.Measured({"flops_ratio_fp32": ratios})])

    assert report["flops_ratio_fp32"] == 2.0
    assert report["ranges"] == {"flops_ratio_fp32": [2.0, 3.0]}


def test_what_was_not_measured_is_null_and_has_no_range(bench: ModuleType) -> None:
    report = bench.report([bench.Measured(figures={"ours_steps_per_s": 100.0})])

    assert all(report[name] is None for name in bench.RATIOS)
    assert report["ranges"] == {}
    assert report["ours_steps_per_s"] == 100.0


def test_several_iterations_together_weigh_by_their_time(bench: ModuleType) -> None:
    paces = [bench.Pace(100, 1.0), bench.Pace(100, 4.0)]

    assert bench.together(paces).steps_per_s == 40.0


def test_without_stable_baselines_only_the_other_script_is_compared_with(
    bench: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench.importlib.util, "find_spec", lambda name: None)

    assert list(bench.scripts()) == ["cleanrl"]
    assert "pip install stable-baselines3" in capsys.readouterr().err


def test_the_beginning_of_a_rollout_is_one_episode(bench: ModuleType) -> None:
    column = np.arange(6, dtype=np.float32)
    rollout = Rollout(
        frames=np.zeros((6, 1, 120, 160), np.uint8),
        actions=np.arange(6),
        log_probs=column,
        values=column,
        rewards=column,
        lengths=np.array([2, 4]),
        last_values=np.zeros(2, np.float32),
        cut=np.zeros(2, np.bool_),
        scans=np.zeros((6, 0), np.float32),
        states=np.zeros((6, 0), np.float32),
    )

    part = importlib.import_module("learn_runs").beginning(rollout, 3)

    assert part.steps == 3
    assert part.lengths.tolist() == [3]
    assert part.frames.shape == (3, 1, 120, 160)
