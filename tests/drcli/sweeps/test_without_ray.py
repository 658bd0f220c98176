"""Sweeps where the extra `ray` is not installed."""

import importlib.util
import subprocess
import sys

import pytest

from drcli.base.errors import NotAvailable
from drcli.config.loading import load_settings
from drcli.sweeps.start_sweep import SweepStart


def test_a_sweep_needs_nothing_of_ray():
    code = "import sys; sys.modules['ray'] = None; import drcli.sweeps.start_sweep"

    subprocess.run([sys.executable, "-c", code], check=True)


def test_with_ray_as_launcher_the_extra_is_named(working_folder, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name == "ray" else found(name)
    )
    settings = load_settings(working_folder, flags={"DR_LAUNCHER": "ray"})

    with pytest.raises(NotAvailable, match="needs Ray, which is not installed") as caught:
        SweepStart(settings, working_folder / "sweep.yaml")

    assert "drcli[ray]" in caught.value.remedy
