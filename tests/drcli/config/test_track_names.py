"""The names of tracks, known without the simulation."""

from pathlib import Path

import numpy as np
import pytest

from drcli.base.errors import Place
from drcli.config import track_names
from drsim.errors import TrackError
from drsim.track.worlds import known_worlds, load_track

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"


def test_the_names_are_those_that_the_simulation_knows(tmp_path):
    np.save(tmp_path / "oval.npy", np.zeros((4, 6)))
    (tmp_path / "square.csv").touch()
    (tmp_path / "notes.txt").touch()

    names = {*track_names.built_in(), *track_names.own(tmp_path)}

    assert sorted(names) == known_worlds(tmp_path)


@pytest.mark.parametrize(
    ("world", "here"),
    [
        ("reinvent_base", True),
        ("reinvent_base_cw", True),
        ("reinvent_carpet_ccw", True),
        ("reinvent_base.npy", True),
        ("mine", True),
        ("mine.npy", True),
        ("mine_ccw", True),
        ("tracks/mine.npy", True),
        ("elsewhere/reinvent_base.npy", False),
        ("reinvent_base_ccw_cw", False),
        ("Reinvent_base", False),
        ("yours", False),
    ],
)
def test_a_track_is_installed_when_the_simulation_finds_it(folder, monkeypatch, world, here):
    monkeypatch.chdir(folder.path)
    tracks = folder.path / "tracks"
    tracks.mkdir()
    track = load_track("reinvent_base")
    np.save(tracks / "mine.npy", np.hstack([track.center, track.inner, track.outer]))

    assert track_names.is_installed(folder.load(f"DR_WORLD_NAME={world}").race) == here
    if here:
        assert load_track(world, tracks)
    else:
        with pytest.raises(TrackError):
            load_track(world, tracks)


def test_no_track_is_missing_where_the_simulation_is_not_installed(folder, monkeypatch):
    monkeypatch.setattr(track_names, "find_spec", lambda name: None)

    assert list(track_names.track_problems(folder.load("DR_WORLD_NAME=Nope").races)) == []


def test_the_missing_track_of_a_worker_is_placed_in_its_file(folder):
    folder.write("worker-2.env", "DR_WORLD_NAME=ben\n")
    settings = folder.load("DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=2\n")

    (problem,) = track_names.track_problems(settings.races)

    assert problem.where == "worker-2.env line 1"
    assert problem.remedy.startswith("Did you mean bean?")


def test_every_world_of_the_community_is_known_by_name():
    assert len(track_names.COMMUNITY) == 127
    assert {"reinvent_carpet", "reinvent_concrete", "reinvent_wood"} < track_names.COMMUNITY


def test_the_page_about_tracks_has_every_track_of_the_community():
    page = (Path(__file__).parents[3] / "docs" / "tracks.md").read_text("utf-8")

    for each in track_names.community().values():
        words = (f"`{each.name}`", f"{each.length_m} m", f"{each.width_m:.2f} m", each.way)
        assert f"| {' | '.join([*words, each.console_name])} |" in page


@pytest.mark.parametrize(
    ("typed", "remedy"),
    [
        ("shanghai", "Write China_track, which consoles call Shanghai Sudu."),
        ("Smile_Speedway", "Write reInvent2019_track, which consoles call Smile Speedway."),
        ("Barcelona", "Did you mean Spain_track? `dr-tracks list"),
        ("Shanghia", "Did you mean China_track? `dr-tracks list"),
        ("Chna_track", "Did you mean China_track? `dr-tracks list"),
        ("speedway", "Did you mean "),
        ("boul", "`dr-tracks list --all` shows all"),
    ],
)
def test_a_track_is_found_by_its_name_in_consoles(folder, typed, remedy):
    (problem,) = track_names.track_problems(folder.load(f"DR_WORLD_NAME={typed}\n").races)

    assert problem.remedy.startswith(remedy)


@pytest.mark.parametrize(
    ("typed", "track"),
    [
        ("Shanghai", "China_track"),
        ("RL Speedway", "2022_summit_speedway"),
        ("oval track", "Oval_track"),
        ("Barcelona", "Barcelona"),  # two tracks
        ("European Seaside Circuit", "European Seaside Circuit"),  # two
        ("re:Invent 2022", "re:Invent 2022"),  # one way each, and none for both
        ("Bowtie_track_cw", "Bowtie_track_cw"),
        ("Shanghai.npy", "Shanghai.npy"),
    ],
)
def test_a_name_of_consoles_means_a_track_if_it_is_that_of_one(tmp_path, typed, track):
    assert track_names.meant(typed, tmp_path) == track


def test_a_file_of_ones_own_keeps_its_name_whatever_consoles_call_so(tmp_path):
    (tmp_path / "Shanghai.npy").touch()

    assert track_names.meant("Shanghai", tmp_path) == "Shanghai"


@pytest.mark.skipif(not ROUTES.is_dir(), reason="the community's routes are not beside the project")
def test_the_names_of_the_community_are_those_of_its_files():
    assert {path.stem for path in ROUTES.rglob("*.npy")} == track_names.COMMUNITY


@pytest.mark.parametrize(
    "world", ["reInvent2019_track", "LGSWide", "arctic_pro_ccw", "LGSWide.npy"]
)
def test_a_track_of_the_community_that_is_not_here_can_be_fetched(folder, world):
    settings = folder.load(f"DR_WORLD_NAME={world}\n")

    (problem,) = track_names.track_problems(settings.races)

    name = world.removesuffix(".npy")
    assert problem.severity == "error"
    assert track_names.to_fetch(settings.races) == [name]
    assert f"`dr-tracks fetch {name}`" in problem.remedy
    assert f"`dr-tracks add {name}.npy`" in problem.remedy


@pytest.mark.parametrize("world", ["reinvent_base", "reinvent_wood", "reinvent_base_cw", "nowhere"])
def test_nothing_else_is_fetched(folder, world):
    assert track_names.to_fetch(folder.load(f"DR_WORLD_NAME={world}\n").races) == []


def test_the_tracks_of_all_workers_are_fetched_once_each(folder):
    for worker, world in ((2, "Spain_track"), (3, "LGSWide"), (4, "Spain_track")):
        folder.write(f"worker-{worker}.env", f"DR_WORLD_NAME={world}\n")

    settings = folder.load("DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=4\nDR_WORLD_NAME=LGSWide\n")

    assert track_names.to_fetch(settings.races) == ["LGSWide", "Spain_track"]
    assert [problem.where for problem in track_names.track_problems(settings.races)] == [
        "run.env line 3",
        "worker-2.env line 1",
        "worker-3.env line 1",
        "worker-4.env line 1",
    ]


@pytest.mark.parametrize(
    ("text", "worlds"),
    [
        ("", ()),
        ("zoo:3", ("zoo-0", "zoo-1", "zoo-2")),
        ("zoo:100-102,zoo-7", ("zoo-100", "zoo-101", "zoo-102", "zoo-7")),
        ("willow, bean  zoo-1 ,willow", ("willow", "bean", "zoo-1")),
        ("bow*,BEAN", ("Bowtie_track", "bowtie_mine", "BEAN")),
        ("reinvent_?a[rs]*", ("reinvent_base", "reinvent_carpet")),
        ("bean,b*", ("bean", "Bowtie_track", "bowtie_mine")),
        ("some/where/route.npy", ("some/where/route.npy",)),
        ("nothing*,zoo:x,zoo:5-3", ()),
    ],
)
def test_a_list_of_tracks_names_each_once_in_order(tmp_path, text, worlds):
    for name in ("Bowtie_track.npy", "bowtie_mine.csv", "bowtie.txt"):
        (tmp_path / name).touch()

    assert track_names.expand_worlds(text, tmp_path) == worlds


PLACE = Place("run.env", 2)


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        (
            "zoo:x",
            "DR_LISTED: zoo:x does not name 1 to 1,000 circuits.",
            "zoo:24 means zoo-0",
        ),
        ("zoo:0", "DR_LISTED: zoo:0 does not", "zoo:24 means"),
        ("zoo:1001", "DR_LISTED: zoo:1001 does not", "zoo:24 means"),
        ("zoo:7-5", "DR_LISTED: zoo:7-5 does not", "zoo:24 means"),
        (
            "bowt*",
            "DR_LISTED: no installed track fits bowt*.",
            "`dr-tracks fetch Bowtie_track`",
        ),
        (
            "mine*",
            "DR_LISTED: no installed track fits mine*.",
            "`dr-tracks list --all` shows all",
        ),
        ("ben", "DR_LISTED: ben is not a known track.", "Did you mean bean?"),
        ("zoo-01", "DR_LISTED: zoo-01 is not a known track.", "`dr-tracks list --all`"),
        (
            "Oval_track",
            "DR_LISTED: Oval_track is a community track",
            "`dr-tracks fetch Oval_track`",
        ),
    ],
)
def test_a_wrong_word_in_a_list_of_tracks_is_told_with_its_place(folder, text, message, remedy):
    race = folder.load("DR_WORLD_NAME=bean\n").race

    (problem,) = track_names.worlds_problems("DR_LISTED", PLACE, f"bean,{text},zoo:2,re*", race)

    assert problem.message.startswith(message)
    assert remedy in problem.remedy
    assert (problem.key, problem.severity) == ("DR_LISTED", "error")
    assert problem.where == "run.env line 2"


def test_a_listed_track_that_a_start_fetches_is_noted(folder):
    race = folder.load("DR_WORLD_NAME=bean\nDR_TRACKS_FETCH=always\n").race

    (problem,) = track_names.worlds_problems("DR_LISTED", PLACE, "Oval_track", race)

    assert problem.severity == "note"
