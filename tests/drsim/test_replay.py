"""Fidelity: our car beside recordings of the reference simulator."""

from pathlib import Path

import pytest

from drsim.replay import load_recordings, measure

SHARED = Path(__file__).resolve().parents[3] / "shared"


def test_recorded_actions_end_within_a_hand_of_the_recorded_pose_one_second_later():
    folder = SHARED / "reference-runs" / "simapp6-continuous" / "training-simtrace"
    if not folder.is_dir():
        pytest.skip("the reference recordings do not lie beside this checkout")
    recordings = load_recordings(folder)[::8]

    found = measure(recordings)

    assert found.windows > 500
    assert found.driven_m > 1.4
    assert found.position_m < 0.12
    assert found.yaw_deg < 6.0


def test_a_folder_without_traces_is_refused(tmp_path):
    with pytest.raises(ValueError, match="holds no"):
        load_recordings(tmp_path)
