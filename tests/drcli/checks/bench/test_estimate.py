"""What measured rates mean for a training (seeds 001-07, 001-10)."""

from dataclasses import replace

import pytest

from drcli.checks.bench.bucket_speed import BucketSpeed
from drcli.checks.bench.machine_benchmark import FIRST_LAP_STEPS, estimate, first_lap_s
from drcli.checks.bench.work_order import Rates, Ready

READY = Ready(
    prepared_s=5.0,
    device="cpu",
    number_format="fp32",
    driving_threads=2,
    learning_threads=2,
    overlaps=False,
    cars=20,
    episodes=20,
    epochs=3,
    batch_size=64,
    weight_bytes=2_000_000,
)
RATES = Rates(
    simulation_steps_per_s=4000.0,
    driving_steps_per_s=2200.0,
    driving_steps_per_core_s=1100.0,
    learning_samples_per_s=3000.0,
    learning_samples_per_core_s=1500.0,
    gradient_steps_per_s=47.0,
    core_s=20.0,
    memory_bytes=600_000_000,
    step_bytes=4000.0,
)
BUCKET = BucketSpeed(100.0, 100.0, 200.0, 5.0, 60, 1, 1)


def test_a_training_takes_the_time_of_all_its_parts():
    found = estimate(READY, RATES, None)

    # 2,000 steps: 1.1 x 2000 / 2200 s of driving, 3 x 2000 / 3000 s of learning.
    assert found.driving_s == pytest.approx(1.0)
    assert found.learning_s == pytest.approx(2.0)
    assert found.training_steps_per_s == pytest.approx(2000 / 3.0)
    assert (found.limited_by, found.limiting_share) == ("learning", pytest.approx(2 / 3))


def test_driving_and_learning_at_the_same_time_take_the_longer_of_both():
    found = estimate(replace(READY, overlaps=True), RATES, None)

    assert found.training_steps_per_s == pytest.approx(1000.0)
    assert found.limiting_share == pytest.approx(1.0)


def test_a_slow_bucket_limits():
    near, far = BUCKET, replace(BUCKET, put_mb_per_s=1.0, get_mb_per_s=2.0, request_ms=80.0)

    assert estimate(READY, RATES, near).limited_by == "learning"
    found = estimate(READY, RATES, far)
    # 10 MB written and read, 14 requests, 0.1 s of polling.
    assert found.bucket_s == pytest.approx(10.0 + 5.0 + 14 * 0.08 + 0.1)
    assert found.limited_by == "bucket"


def test_the_first_lap_comes_after_the_start_and_its_steps():
    least, median, most = first_lap_s(READY, RATES, None)

    per_step = 1.1 / 2200 + 3 / 3000
    assert (least, median, most) == pytest.approx(
        tuple(5.0 + steps * per_step for steps in FIRST_LAP_STEPS)
    )
