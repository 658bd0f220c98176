"""A machine that would drive differently may not join, and is told why."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.records.job import Job, JoinRecord
from drcli.run.join_check import SOURCE, offer, refuse_other_machine, versions
from drcli.run.plan import planned_job


def job_in(folder: Path, **settings: str) -> Job:
    folder.mkdir(exist_ok=True)
    (folder / "run.env").write_text("".join(f"{k}={v}\n" for k, v in settings.items()))
    return planned_job(load_settings(folder, environ={}), seed=7, began_at=0.0)


@pytest.fixture
def there(tmp_path) -> Job:
    return job_in(tmp_path / "there", DR_WORLD_NAME="reinvent_base")


def test_the_same_program_may_join(there):
    refuse_other_machine(offer(there), there)


@pytest.mark.parametrize("name", ["drcli", "torch", "mujoco", "numpy", SOURCE])
def test_another_version_is_refused_and_named(there, name):
    record = offer(there)
    other = replace(record, versions={**record.versions, name: "9.9.9"})

    with pytest.raises(SettingsError) as refused:
        refuse_other_machine(other, there)

    named = SOURCE if name == SOURCE else f"{name} 9.9.9"
    assert named in str(refused.value)
    assert "Install" in refused.value.remedy


def test_a_build_of_torch_for_other_hardware_is_the_same_version():
    assert "+" not in versions()["torch"]


def test_a_track_of_the_racer_must_be_there_and_the_same(tmp_path):
    def job_with(folder: str, width: float | None) -> Job:
        job = job_in(tmp_path / folder, DR_WORLD_NAME="my_track")
        tracks = tmp_path / folder / "tracks"
        tracks.mkdir()
        if width is not None:
            np.save(tracks / "my_track.npy", np.full((9, 6), width))
        return job

    record = offer(job_with("training", 1.0))

    refuse_other_machine(record, job_with("same", 1.0))
    with pytest.raises(SettingsError, match=r"which is not in .*missing/tracks on this machine"):
        refuse_other_machine(record, job_with("missing", None))
    with pytest.raises(SettingsError, match="is not the one that the training uses"):
        refuse_other_machine(record, job_with("other", 2.0))


def test_what_a_training_offers_has_no_secrets_and_no_addresses(tmp_path):
    job = job_in(
        tmp_path / "there",
        DR_WEBHOOK_URL="https://hooks.example.com/secret-token",
        DR_SMTP_URL="smtps://me:password@mail.example.com:465",
        DR_ON_END="curl -H token:hidden",
    )

    text = offer(job).encode().decode()

    for secret in ("secret-token", "password", "hidden"):
        assert secret not in text
    again = JoinRecord.decode(offer(job).encode())
    assert again.session == job.session
    assert again.job["seed"] == 7
