"""The player's answers: what an episode shows, and what it says about what is missing."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from drcli.base.errors import SettingsError, StorageError
from drcli.model import keys
from drcli.view.playback.episode_player import CACHE_BYTES, MOST_STEPS, RecentlyUsed
from drcli.view.playback.player_handle import facts_of, pack, unpack
from drcli.view.playback.player_process import answer_of
from played_model import EVALUATION, GONE, TRAINING


def ask(player, do, trace=EVALUATION, **more):
    return unpack(player.answer({"do": do, "model": "team/m", "trace": trace, **more}))


def test_an_opened_trace_tells_its_episodes_and_marks_the_best_and_the_worst(player):
    facts, pictures = ask(player, "open")

    assert pictures == []
    assert [each["mark"] for each in facts["episodes"]] == ["worst", "best", ""]
    assert facts["episodes"][1]["progress"] > facts["episodes"][2]["progress"]
    assert facts["episodes"][0]["status"] == "off_track"
    assert facts["policy"] == {"checkpoint": 3, "available": [3, 5], "sentence": ""}
    assert (facts["world"], facts["race_type"]) == ("reinvent_base", "TIME_TRIAL")
    assert facts["used_parameters"] == ["speed", "progress"]
    assert len(facts["outline"]["center"]) == 119


def test_a_step_has_its_picture_its_parameters_and_the_choices_of_the_policy(player):
    where = {"episode": 1, "first": 5, "count": 3}

    facts, pictures = ask(player, "steps", **where)
    made, _ = ask(player, "policy", checkpoint=3, **where)
    lap, _ = ask(player, "lap", episode=1)

    assert [Image.open(BytesIO(each)).size for each in pictures] == [(160, 120)] * 3
    assert len({*pictures}) == 3
    assert facts["parameters"]["columns"]["speed"] == [2.0] * 3
    assert facts["parameters"]["columns"]["steps"] == [6.0, 7.0, 8.0] == lap["step"][5:8]
    assert np.array(made["probabilities"]).sum(axis=1) == pytest.approx(1.0, abs=1e-3)
    assert len(made["actions"]) == len(made["probabilities"][0]) == 4
    assert len(made["value"]) == len(made["entropy"]) == 3
    assert len(lap["time_s"]) == len(lap["reward"]) == len(lap["state"]) == 40
    assert lap["state"][-1] == "Off track"


def test_a_map_lies_over_the_picture(player):
    where = {"episode": 1, "first": 0, "count": 2}

    plain = ask(player, "steps", **where)[1]
    explained = ask(player, "explain", checkpoint=3, **where)[1]
    other = ask(player, "explain", checkpoint=5, **where)[1]

    assert explained != other
    for grey, coloured in zip(plain, explained, strict=True):
        assert Image.open(BytesIO(grey)).mode == "L"
        colours = np.asarray(Image.open(BytesIO(coloured)), np.int64)
        assert colours.shape == (120, 160, 3)
        assert np.ptp(colours, axis=2).max() > 30


def test_what_a_training_drove_has_the_checkpoint_of_its_iteration(player):
    there, _ = ask(player, "open", TRAINING)
    gone, _ = ask(player, "open", GONE)

    assert there["policy"]["checkpoint"] == 3
    assert there["policy"]["sentence"] == ""
    assert gone["policy"]["checkpoint"] == 2
    assert "Checkpoint 2, which drove, is no longer there" in gone["policy"]["sentence"]
    with pytest.raises(SettingsError, match="2"):
        ask(player, "policy", GONE, checkpoint=2, episode=0, first=0, count=1)
    assert ask(player, "steps", GONE, episode=0, first=0, count=30)[1]


def test_a_cut_trace_shows_what_can_be_read(player, bucket):
    whole = bucket.get(f"team/m/{EVALUATION}")
    bucket.put(f"team/m/{EVALUATION}", whole[: len(whole) * 2 // 3])

    facts, _ = ask(player, "open")

    assert 1 <= len(facts["episodes"]) <= 2
    assert any("cannot be read" in note for note in facts["notes"])


def test_a_trace_that_was_written_again_is_read_again(player, bucket):
    before = ask(player, "steps", episode=0, first=0, count=2)[1]
    bucket.put(f"team/m/{EVALUATION}", bucket.get(f"team/m/{GONE}"))

    assert len(ask(player, "open")[0]["episodes"]) == 1
    assert ask(player, "lap", episode=0)[0]["number"] == 0
    assert len(ask(player, "steps", episode=0, first=20, count=2)[1]) == len(before)


def test_without_its_track_an_episode_still_has_numbers(player, bucket):
    text = bucket.get(f"team/m/{GONE}").decode().replace("17.7", "93.5")
    bucket.put(f"team/m/{GONE}", text.encode())

    facts, _ = ask(player, "open", GONE)
    steps, pictures = ask(player, "steps", GONE, episode=0, first=0, count=4)

    assert facts["outline"] is None
    assert any("no camera pictures" in note for note in facts["notes"])
    assert (steps["parameters"], pictures) == (None, [])
    assert len(ask(player, "lap", GONE, episode=0)[0]["reward"]) == 30


def test_damaged_files_beside_the_trace_are_told(player, bucket):
    bucket.put(keys.recording_of(f"team/m/{EVALUATION}"), b"{")
    bucket.put(keys.model_metadata("team/m"), b"{")

    facts, _ = ask(player, "open")

    assert any("recording.json is damaged" in note for note in facts["notes"])
    assert any("model_metadata" in note for note in facts["notes"])
    assert facts["policy"]["checkpoint"] is None
    assert "Nobody recorded" in facts["policy"]["sentence"]
    assert ask(player, "steps", episode=0, first=0, count=1)[1]


def test_what_does_not_exist_is_refused(player):
    with pytest.raises(SettingsError, match="has 3 episodes"):
        ask(player, "lap", episode=3)
    for first, count in ((12, 1), (0, MOST_STEPS + 1), (0, 0)):
        with pytest.raises(SettingsError, match="it has 12"):
            ask(player, "steps", episode=0, first=first, count=count)
    with pytest.raises(StorageError, match="does not exist"):
        ask(player, "open", "training-simtrace/99-iteration.csv")
    with pytest.raises(SettingsError, match="no trace of a model"):
        ask(player, "open", "../m/training-simtrace/0-iteration.csv")


def test_every_error_is_an_answer(player, monkeypatch):
    request = {"do": "open", "model": "team/m", "trace": "nonsense"}
    refused = facts_of(answer_of(player, request))["error"]
    monkeypatch.setattr(player, "_opened", lambda *_: [][0])
    broken = facts_of(answer_of(player, request))["error"]

    assert refused["code"] == 3
    assert "fault in the program" in broken["message"]
    monkeypatch.setattr(player, "_opened", lambda *_: (_ for _ in ()).throw(MemoryError))
    assert "more memory" in facts_of(answer_of(player, request))["error"]["message"]


def test_kept_pictures_stay_within_their_bound(player):
    kept = RecentlyUsed(1000, len)
    for number in range(50):
        kept.keep(("a", number), bytes(100))
    kept.keep(("a", 49), bytes(60))
    kept.drop(lambda key: key[1] == 48)

    assert kept.size == 860
    assert kept.find(("a", 0)) is None
    assert kept.find(("a", 49)) == bytes(60)
    ask(player, "steps", episode=1, first=0, count=40)
    assert 40 * 500 < player.pictures.size < CACHE_BYTES


def test_a_packed_answer_that_is_cut_off_is_noticed():
    data = pack({"a": float("nan")}, [b"xyz", b""])

    assert unpack(data) == ({"a": None}, [b"xyz", b""])
    for cut in (data[:-1], data[:6]):
        with pytest.raises(ValueError, match=r"cut off|lengths"):
            unpack(cut)
