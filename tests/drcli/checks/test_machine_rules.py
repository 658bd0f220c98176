"""Rule V-50: a machine with room, and one without."""

import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from drcli.checks.machine_rules import review_disk, review_gpu, review_memory
from drcli.config.loading import load_settings
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata

GB = 1_000_000_000


@pytest.fixture
def settings(working_folder):
    """Two workers on a local bucket."""
    return load_settings(working_folder)


@pytest.mark.parametrize(("free_gb", "told"), [(2.1, 0), (1.9, 1)])
def test_a_disk_that_is_nearly_full_is_told_once(settings, monkeypatch, free_gb, told):
    usage = SimpleNamespace(free=int(free_gb * GB))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    found = list(review_disk(settings.storage, settings.directory))

    assert [(item.rule, item.severity) for item in found] == [("V-50", "warning")] * told
    assert all("only 1.9 GB of the disk is free" in item.message for item in found)


@pytest.mark.parametrize(("free_gb", "told"), [(2.2, 0), (2.0, 1)])
def test_memory_has_to_suffice_for_trainer_and_workers(settings, monkeypatch, free_gb, told):
    memory = SimpleNamespace(available=int(free_gb * GB))
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)

    found = list(review_memory(settings.workers, settings.place("DR_WORKERS"), None, None))

    assert [item.where for item in found] == ["run.env line 3"] * told


@pytest.mark.parametrize(("steps", "told"), [(10_000, 0), (100_000, 1)])
def test_the_replay_of_sac_counts_as_memory(settings, monkeypatch, steps, told):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=3 * GB))
    space = b'{"speed": {"low": 1, "high": 2}, "steering_angle": {"low": -9, "high": 9}}'
    kinds = b'"action_space_type": "continuous", "training_algorithm": "sac"'
    metadata = ModelMetadata.from_bytes(b'{"action_space": ' + space + b", " + kinds + b"}")

    found = list(
        review_memory(
            settings.workers,
            settings.place("DR_WORKERS"),
            Hyperparameters(sac_replay_steps=steps),
            metadata,
        )
    )

    assert ["sac_replay_steps" in item.remedy for item in found] == [True] * told


def test_two_full_disks_are_told_both_and_one_disk_once(settings, monkeypatch):
    free = iter([1_000_000, 999_999, 1_000_000, 1_000_000])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=next(free)))
    (settings.directory / settings.s3_data_dir).mkdir(parents=True)

    same = list(review_disk(settings.storage, settings.directory))
    monkeypatch.setattr(Path, "stat", lambda path, **_: SimpleNamespace(st_dev=hash(path)))
    monkeypatch.setattr(Path, "exists", lambda _: True)
    different = list(review_disk(settings.storage, settings.directory))

    assert (len(same), len(different)) == (1, 2)


@pytest.fixture
def gpus(monkeypatch):
    """Have nvidia-smi answer."""

    def answer(text: str) -> None:
        monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/nvidia-smi")
        done = SimpleNamespace(stdout=text, stderr="", returncode=0)
        monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)

    return answer


ROOMY, FULL = "0, GPU-aa11, H100, 570.86, 81559, 9000\n", "1, GPU-bb22, H100, 570.86, 81559, 800\n"


@pytest.mark.parametrize(
    ("answer", "told"), [(ROOMY + FULL, 0), (FULL, 1), ("", 0), ("Failed to initialize", 0)]
)
def test_a_gpu_needs_free_memory_where_there_is_one(gpus, answer, told):
    gpus(answer)

    found = list(review_gpu("", {}))

    assert ["0.8 GB of GPU memory" in item.message for item in found] == [True] * told


@pytest.mark.parametrize(
    ("visible", "told"),
    [("0", 0), ("1", 1), ("0,1", 0), ("GPU-bb", 1), ("", 0), ("-1", 0), ("7", 0)],
)
def test_only_gpus_that_the_environment_shows_count(gpus, visible, told):
    gpus(ROOMY + FULL)

    found = list(review_gpu("", {"CUDA_VISIBLE_DEVICES": visible}))

    assert len(found) == told


@pytest.mark.parametrize(("chosen", "told"), [("0", 0), ("1", 1), ("-1", 0), ("", 1)])
def test_the_setting_for_the_learners_gpus_wins_over_the_environment(
    working_folder, gpus, chosen, told
):
    with (working_folder / "system.env").open("a") as file:
        file.write(f"\nDR_SAGEMAKER_CUDA_DEVICES={chosen}\n")
    gpus(ROOMY + FULL)

    found = list(
        review_gpu(
            load_settings(working_folder).sagemaker_cuda_devices, {"CUDA_VISIBLE_DEVICES": "1"}
        )
    )

    assert ["DR_SAGEMAKER_CUDA_DEVICES=-1" in item.remedy for item in found] == [True] * told


def test_without_a_gpu_nothing_is_said_about_one(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)

    assert list(review_gpu("", {})) == []
