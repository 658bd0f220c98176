"""This machine, measured as a racer measures it (seeds 001-07, 001-10)."""

import json
import os
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError, WorkerDied
from drcli.checks.bench import bucket_speed, machine_benchmark
from drcli.checks.bench.machine_benchmark import ProcessorUse, measure_machine
from drcli.checks.bench.work_order import WorkOrder

from .test_estimate import RATES, READY


@pytest.fixture
def orders(monkeypatch) -> list[WorkOrder]:
    """What would be measured, instead of measuring it."""
    given: list[WorkOrder] = []

    def ask(order, most_s):
        given.append(order)
        return READY, RATES

    monkeypatch.setattr(machine_benchmark, "_ask", ask)
    return given


@pytest.mark.nightly
def test_a_machine_is_measured_in_a_folder_without_settings_and_nothing_stays(
    working_folder, tmp_path_factory, monkeypatch, dr, capsys
):
    for name in ("run.env", "system.env"):
        (working_folder / name).unlink()
    temporary = tmp_path_factory.mktemp("temporary")
    monkeypatch.setattr(bucket_speed.tempfile, "gettempdir", lambda: str(temporary))
    monkeypatch.setattr(machine_benchmark, "MEASURED_S", 1.0)
    monkeypatch.setattr(machine_benchmark, "BUCKET_S", 0.5)

    code = dr("bench", "--json")

    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0
    assert list(working_folder.iterdir()) == []
    assert list(temporary.iterdir()) == []
    rates, estimate = report["standard"]["rates"], report["standard"]["estimate"]
    assert min(value for value in rates.values()) > 0
    assert report["number"] == pytest.approx(estimate["training_steps_per_s"], abs=0.1)
    assert rates["simulation_steps_per_s"] > rates["driving_steps_per_s"]
    assert report["own"] is None
    assert report["folder"] is None
    assert report["bucket"]["speed"]["requests_per_s"] > 0


def test_the_files_and_limits_of_a_folder_count(working_folder, orders):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=bean\n")
    (working_folder / "system.env").write_text("DR_THREADS=1\nDR_PRIORITY=low\n")
    custom = working_folder / "custom_files"
    custom.mkdir()
    (custom / "hyperparameters.json").write_text('{"batch_size": 32}')

    report = measure_machine(working_folder, with_bucket=False)

    shipped, own = orders
    assert (shipped.race.world_name, own.race.world_name) == ("reinvent_base", "bean")
    assert "32" in own.hyperparameters
    assert {(order.train.threads, order.train.priority) for order in orders} == {(1, "low")}
    assert report.own is not None
    assert (report.threads, report.priority, report.bucket) == (1, "low", None)
    assert {path.name for path in working_folder.iterdir()} == {
        "run.env",
        "system.env",
        "custom_files",
    }


def test_damaged_files_of_a_racer_are_left_out_with_the_reason(working_folder, orders):
    (working_folder / "custom_files").mkdir()
    (working_folder / "custom_files" / "model_metadata.json").write_text("{]")

    report = measure_machine(working_folder, with_bucket=False)

    assert len(orders) == 1
    assert "model_metadata.json" in report.own_left_out


def test_wrong_settings_are_refused_before_anything_is_measured(working_folder, orders):
    (working_folder / "system.env").write_text("DR_THREADS=many\n")

    with pytest.raises(SettingsError, match="DR_THREADS"):
        measure_machine(working_folder, with_bucket=False)

    assert orders == []


def test_a_measurement_that_fails_says_why(working_folder, monkeypatch):
    monkeypatch.setattr(machine_benchmark.sys, "executable", "/bin/false")

    with pytest.raises(WorkerDied, match="exit code 1"):
        measure_machine(working_folder, with_bucket=False)


def test_folders_of_killed_measurements_are_removed_and_others_stay(tmp_path):
    gone, mine = tmp_path / ".dr-bench-999999999", tmp_path / f".dr-bench-{os.getpid()}"
    for folder in (gone, mine, tmp_path / ".dr-bench-notes"):
        folder.mkdir()

    bucket_speed.sweep(Path(tmp_path))

    assert {path.name for path in tmp_path.iterdir()} == {mine.name, ".dr-bench-notes"}


@pytest.mark.parametrize(("share", "told"), [(0.02, False), (0.6, True)])
def test_a_busy_machine_is_told(working_folder, orders, monkeypatch, share, told):
    monkeypatch.setattr(ProcessorUse, "of_others", lambda self: (share, 0.0))

    report = measure_machine(working_folder, with_bucket=False)

    assert any("busy" in text for text in report.warnings) is told
