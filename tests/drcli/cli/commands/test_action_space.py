"""`dr action-space`: shows, generates, and writes only what was agreed to. Seed 003-05."""

import json
import re

import pytest

from drcli.base.errors import MOST_SHOWN
from drcli.model.files.model_metadata import ModelMetadata

TRACE = "episode,steer,throttle,progress,episode_status\n" + "".join(
    f"0,{20 if k % 50 < 25 else -5},{1 if k % 50 < 25 else 2},{k / 2},"
    f"{'lap_complete' if k == 200 else 'in_progress'}\n"
    for k in range(1, 201)
)


@pytest.fixture
def folder(dr, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DR_DIR", raising=False)
    dr("init", "--force")
    (tmp_path / "lap.csv").write_text(TRACE)
    capsys.readouterr()
    return tmp_path


@pytest.fixture
def answer(monkeypatch):
    """What is said to a question; the question is kept."""
    asked = []

    def answer(yes: bool) -> list[str]:
        def agree(question, *, yes=False, **_):
            asked.append(question)
            if not agree.answer:
                raise SystemExit(1)

        agree.answer = yes
        monkeypatch.setattr("drcli.cli.prompts.agree", agree)
        return asked

    return answer


def own(folder):
    return folder / "custom_files" / "model_metadata.json"


def report_of(dr, capsys, *words):
    code = dr("action-space", *words, "--json")
    out = capsys.readouterr().out
    assert code == 0, out
    return json.loads(out)


def test_actions_are_drawn_here_and_as_a_picture(dr, folder, capsys):
    code = dr("action-space", "show", "-o", "a.png")

    out = capsys.readouterr().out
    assert code == 0
    assert (folder / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert "7 actions." in out
    picture = out.partition("left ")[0]
    rows = {mark: row for row in picture.splitlines() for mark in "0123456" if mark in row}
    assert len(rows) == 7
    # Action 0 turns to the right, action 6 as far to the left.
    assert rows["0"].index("0") > len(rows["0"]) // 2 > rows["6"].index("6")
    assert re.search(r"^ *3 +0° +1\.8 m/s", out, re.MULTILINE)


def test_continuous_actions_are_drawn_too(dr, folder, capsys):
    data = json.loads(own(folder).read_text())
    data["action_space"] = {
        "steering_angle": {"low": -20, "high": 25},
        "speed": {"low": 1, "high": 3},
    }
    own(folder).write_text(json.dumps(data | {"action_space_type": "continuous"}))

    code = dr("action-space", "show", "-o", "a.png")

    out = capsys.readouterr().out
    assert code == 0
    assert "steering -20 to 25 degrees, speed 1 to 3 m/s" in out
    assert out.count("#") > 50


def test_nothing_is_written_without_write(dr, folder, capsys):
    before = own(folder).read_bytes()

    report = report_of(dr, capsys, "generate", "--angles", "3", "--speeds", "1")

    assert own(folder).read_bytes() == before
    assert (report["changes"], report["written"], report["backup"]) == (True, False, None)
    assert [action["steering_angle"] for action in report["actions"]] == [-30, 0, 30]


def test_what_is_written_keeps_the_rest_of_the_file_and_a_copy(dr, folder, capsys):
    before = own(folder).read_bytes()
    own(folder).write_bytes(
        before.replace(b'"version": "5"', b'"version": "5",\n  "mine": [1, "x"]')
    )
    before = own(folder).read_bytes()

    report = report_of(
        dr,
        capsys,
        "generate",
        "--angles",
        "5",
        "--speeds",
        "3",
        "--max-speed",
        "2",
        "--write",
        "-f",
    )

    written = own(folder).read_bytes()
    assert (report["written"], report["backup"]) == (True, f"{own(folder)}.bak")
    assert own(folder).with_name("model_metadata.json.bak").read_bytes() == before
    metadata = ModelMetadata.from_bytes(written)
    assert metadata.action_space.num_actions == 15
    assert json.loads(written)["mine"] == [1, "x"]
    assert {k: v for k, v in json.loads(before).items() if k != "action_space"} == {
        k: v for k, v in json.loads(written).items() if k != "action_space"
    }


def test_it_asks_before_it_writes_and_a_no_changes_nothing(dr, folder, capsys, answer):
    before = own(folder).read_bytes()
    asked = answer(False)

    dr("action-space", "generate", "--write")

    assert own(folder).read_bytes() == before
    assert "has other actions" in asked[0]
    answer(True)
    dr("action-space", "generate", "--write")
    assert own(folder).read_bytes() != before


def test_the_new_actions_are_shown_before_it_asks(dr, folder, capsys, monkeypatch):
    shown = []
    monkeypatch.setattr(
        "drcli.cli.prompts.agree", lambda *_, **__: shown.append(capsys.readouterr().out)
    )

    dr("action-space", "generate", "--angles", "5", "--speeds", "2", "--write")

    [before] = shown
    assert " 9 " in before  # the last of ten actions
    after = capsys.readouterr()
    assert after.out == ""
    assert "has these actions now; the old ones are in" in after.err


def test_the_same_actions_are_not_written_again(dr, folder, capsys, answer):
    asked = answer(True)
    dr("action-space", "generate", "--write", "-f")
    first = own(folder).read_bytes()
    own(folder).with_name("model_metadata.json.bak").unlink()
    capsys.readouterr()

    report = report_of(dr, capsys, "generate", "--write")

    assert asked == []
    assert report["changes"] is False
    assert own(folder).read_bytes() == first
    assert not own(folder).with_name("model_metadata.json.bak").exists()


@pytest.mark.parametrize(
    ("angles", "says"),
    [("5", "has 1 checkpoint, trained with 7 actions; with 10 actions"), ("none", "")],
)
def test_a_model_with_checkpoints_is_named_when_the_number_changes(
    dr, folder, capsys, answer, angles, says
):
    asked = answer(False)
    model = folder / "data" / "s3" / "bucket" / "rl-deepracer-sagemaker" / "model"
    model.mkdir(parents=True)
    (model / "model_metadata.json").write_bytes(own(folder).read_bytes())
    (model / "3_Step-900.ckpt.json").write_text("{}")
    (model / "3_Step-900.ckpt.safetensors").write_bytes(b"x")

    if angles == "none":
        dr("action-space", "show")
        assert "checkpoint, trained" not in capsys.readouterr().out
        return
    dr("action-space", "generate", "--angles", angles, "--speeds", "2", "--write")

    shown = capsys.readouterr().out
    assert says in shown
    assert "DR_LOCAL_S3_MODEL_PREFIX" in shown
    assert asked[0].endswith("has other actions. Replace them?")  # and does not say it again


def test_the_actions_of_a_lap(dr, folder, capsys):
    report = report_of(dr, capsys, "from-lap", "lap.csv", "-k", "2", "--smooth", "1")

    found = [(action["steering_angle"], action["speed"]) for action in report["actions"]]
    assert found == [(-5, 2), (20, 1)]
    assert [action["share"] for action in report["actions"]] == [0.5, 0.5]
    assert "13.33 s" in report["notes"][0]
    assert report["notes"][1].startswith("100% of its steps")


def test_the_histogram_of_a_folder(dr, folder, capsys):
    (folder / "other.csv").write_text("name,points\nme,3\n")

    report = report_of(dr, capsys, "from-histogram", str(folder))

    assert [action["speed"] for action in report["actions"]] == [2, 1]
    assert report["notes"] == [
        f"From 200 steps in {folder}/lap.csv.",
        "They cover 100% of them.",
    ]


def test_the_traces_of_the_model_in_the_bucket(dr, folder, capsys):
    there = folder / "data/s3/bucket/rl-deepracer-sagemaker/training-simtrace"
    there.mkdir(parents=True)
    (there / "0-iteration.csv").write_text(TRACE)
    (there / "1-iteration.csv").write_text("half")

    report = report_of(dr, capsys, "from-lap")

    assert "rl-deepracer-sagemaker/training-simtrace/0-iteration.csv" in report["notes"][0]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("from-lap", "nowhere.csv"), "nowhere.csv cannot be read"),
        (("from-lap", "run.env"), "run.env is not a trace of a drive"),
        (("from-lap", "off.csv"), "no complete lap"),
        (("from-histogram", "custom_files"), "holds no trace"),
        (("from-histogram", "lap.csv", "--least", "0.9"), "90.0%"),
        (("from-lap",), "has no trace of a drive"),
        (("show", "--file", "none.json"), "none.json is missing"),
        (("show", "-o", "run.env"), "run.env exists already"),
        (("generate", "--file", "broken.json"), "broken.json"),
        (("generate", "--file", "sac.json"), "continuous"),
    ],
)
def test_mistakes_are_one_sentence_and_change_nothing(dr, folder, capsys, words, says):
    (folder / "off.csv").write_text(TRACE.replace("lap_complete", "off_track"))
    (folder / "broken.json").write_text('{"action_space": [')
    sac = json.loads(own(folder).read_text()) | {"training_algorithm": "sac"}
    (folder / "sac.json").write_text(json.dumps(sac))
    (folder / "data/s3/bucket").mkdir(parents=True)

    code = dr("action-space", *words, *(["--write", "-f"] if words[0] == "generate" else []))

    said = capsys.readouterr().err
    assert code == 3
    assert says in said
    assert "Traceback" not in said
    assert not list(folder.glob("*.bak"))


def test_many_warnings_are_cut_short(dr, folder, capsys):
    dr("action-space", "generate", "--speeds", "100", "--json")

    notes = json.loads(capsys.readouterr().out)["notes"]
    assert sum("is less than the car can do" in note for note in notes) == MOST_SHOWN
    assert notes[-1] == "And 6 more like these."  # 5 angles by 9 slow speeds, and their number


def test_a_file_that_does_not_exist_yet_becomes_the_shipped_one(dr, folder, capsys):
    report_of(
        *(dr, capsys, "generate", "--continuous", "--min-speed", "0.5", "--max-speed", "1"),
        *("--file", "new/model_metadata.json", "--write", "-f"),
    )

    metadata = ModelMetadata.from_bytes((folder / "new/model_metadata.json").read_bytes())
    assert (metadata.action_space.low, metadata.action_space.high) == ((-30, 0.5), (30, 1))
    assert metadata.sensor == ("FRONT_FACING_CAMERA",)


def test_sac_gets_ranges(dr, folder, capsys):
    sac = json.loads(own(folder).read_text()) | {"training_algorithm": "sac"}
    own(folder).write_text(json.dumps(sac))

    report = report_of(dr, capsys, "generate", "--continuous", "--max-speed", "2", "--write", "-f")

    assert report["written"]
    assert ModelMetadata.from_bytes(own(folder).read_bytes()).action_space.continuous
