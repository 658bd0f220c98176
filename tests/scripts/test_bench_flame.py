"""What scripts/bench/flame.py reads in a recording, and draws."""

import importlib
from types import ModuleType

import pytest

LOOP = "_code (<frozen runpy>);run (drcli/workers/worker_process.py);learn (drcli/train/trainer.py)"

RECORDING = f"""\
{LOOP};update (drcli/learn/ppo.py) 30
{LOOP};wait (threading.py) 10
Thread._bootstrap (threading.py);_worker (concurrent/futures/thread.py) 500
"""


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("flame")


def test_bars_are_those_of_the_main_thread_from_the_loop_of_the_worker_on(bench):
    bars = bench.bars_of(RECORDING)

    assert bars.samples == 40
    (loop,) = bars.above.values()
    assert {name.split()[0]: bar.samples for name, bar in loop.above.items()} == {
        "update": 30,
        "wait": 10,
    }


def test_a_picture_is_drawn_also_of_a_worker_that_was_not_seen(bench, tmp_path):
    bench.draw(
        {"trainer": bench.bars_of(RECORDING), "sim-0": bench.bars_of("")}, tmp_path / "flame.png"
    )

    assert (tmp_path / "flame.png").read_bytes().startswith(b"\x89PNG")
