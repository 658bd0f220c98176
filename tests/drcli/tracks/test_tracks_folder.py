"""How errors of the simulation about a route file are told in the words of the command."""

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.tracks.tracks_folder import add_track

RING = [[4 * np.cos(a), 3 * np.sin(a)] for a in np.linspace(0, 2 * np.pi, 60)]


@pytest.mark.parametrize("name", ["my_width_m", "width_m"])
def test_the_name_of_a_file_is_not_taken_for_a_parameter(tmp_path, name):
    file = tmp_path / f"{name}.npy"

    with pytest.raises(SettingsError) as refusal:
        add_track(file, tmp_path / "tracks")

    assert str(refusal.value).startswith(f"{file}: ")


def test_a_parameter_is_told_as_its_option(tmp_path):
    drawing = tmp_path / "length_m.svg"
    drawing.write_text("<svg/>")

    with pytest.raises(SettingsError) as refusal:
        add_track(drawing, tmp_path / "tracks")

    told = f"{refusal.value} {refusal.value.remedy}"
    assert "--length" in told.partition(": ")[2]


def test_a_ring_whose_ends_were_joined_says_so(tmp_path):
    file = tmp_path / "ring.npy"
    middle = np.array(RING)[:-1]
    np.save(file, np.concatenate([middle, 0.9 * middle, 1.1 * middle], axis=1))

    facts = add_track(file, tmp_path / "tracks")

    assert facts.closed
    told = [str(line) for line in facts.view()]
    assert f"Its ends were {facts.joined_m:.2f} m apart, less than the road is wide, " in told[-1]
