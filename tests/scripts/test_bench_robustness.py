"""What scripts/bench/robustness.py ranks, and under what."""

import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from drcli.drive.evaluate_many import grid

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "bench"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    monkeypatch.setattr(sys, "path", [str(SCRIPTS), *sys.path])
    return SimpleNamespace(**runpy.run_path(str(SCRIPTS / "robustness.py")))


def test_the_rank_correlation_is_spearmans(bench: SimpleNamespace) -> None:
    # Ranks 1 2 3 4 and 1 3 2 4: 1 - 6 * (1 + 1) / (4 * 15) = 0.8.
    assert bench.rank_correlation([1.0, 5.0, 9.0, 99.0], [0.1, 0.3, 0.2, 7.0]) == pytest.approx(0.8)
    assert bench.rank_correlation([1.0, 2.0, 3.0], [9.0, 5.0, 1.0]) == pytest.approx(-1.0)


def test_equal_values_share_their_ranks(bench: SimpleNamespace) -> None:
    # Ranks 1.5 1.5 3 against 1 2 3: covariance 0.75 of (sqrt(1.5) * sqrt(2)) / 2.
    assert bench.rank_correlation([4.0, 4.0, 6.0], [1.0, 2.0, 3.0]) == pytest.approx(0.8660254)


def test_what_is_held_out_is_not_in_the_grid(bench: SimpleNamespace) -> None:
    known = {cell.conditions for cell in grid(0)}
    held = bench.held_out(0)

    assert len(held) == bench.HELD_OUT
    assert not known & {cell.conditions for cell in held}
    assert all(len(cell.conditions.to_dict()) >= 2 for cell in held)
    assert bench.held_out(0) == held
