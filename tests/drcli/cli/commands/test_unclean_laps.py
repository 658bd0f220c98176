"""A model that gets 15 % far and finishes laps with nine resets each: no output hides these."""

import json
import re
from dataclasses import replace

import pytest
from starlette.testclient import TestClient

from drcli.model import keys
from drcli.records.episode_metrics import encode_metrics_file
from drcli.records.iteration import encode_history
from drcli.records.run_record import RunRecord, WorkerRecord
from drcli.web.console_app import build_app
from drsim.track.worlds import load_track
from recorded_drives import trace_csv, trace_rows
from stored_models import STAMP, StoredModels, iteration, trial

PREFIX, RESETS, PENALTY_ROWS, ROWS = "weak", 9, 5, 121
LAP_MS = round(1000 * ROWS / 15)
TIME = re.compile(r"\b0*8\.07\b|\b0*8\.067\b|\b0*5\.07\b|\b0*5\.067\b")
"""Of the laps, with and without penalties."""

HIDDEN = re.compile(r"\d+ of \d+ laps?\b(?! clean)|\d+/\d+ laps?\b(?! clean)|all laps")


def lap_rows(episode):
    """A lap on which the car is put back nine times, and waits each time."""
    rows = trace_rows(
        load_track("reinvent_base"), episode=episode, rows=ROWS, clock_s=100.0 * episode
    )
    for reset in range(RESETS):
        first = 10 + 12 * reset
        rows[first]["episode_status"] = "off_track"
        for waiting in range(first + 1, first + 1 + PENALTY_ROWS):
            rows[waiting]["episode_status"] = "pause"
    rows[-1] |= {"progress": "100.0", "episode_status": "lap_complete"}
    return rows


@pytest.fixture
def weak(working_folder, monkeypatch):
    """The folder in which it was trained and evaluated."""
    (working_folder / "run.env").write_text(f"DR_LOCAL_S3_MODEL_PREFIX={PREFIX}\n")
    stored = StoredModels(working_folder)
    stored.model(PREFIX)
    bad = {"mean_progress": 10.0, "evaluation_progress": [15.0] * 3, "evaluation_lap_s": []}
    stored.put(keys.history(PREFIX), encode_history([replace(iteration(n), **bad) for n in (0, 1)]))
    stored.evaluation(PREFIX)
    counts = {"off_track_count": RESETS, "reset_count": RESETS}
    counts["penalty_in_milliseconds"] = round(1000 * RESETS * PENALTY_ROWS / 15)
    trials = [trial(number, LAP_MS, **counts) for number in (1, 2, 3)]
    metrics = keys.evaluation_metrics(keys.metrics_prefix(PREFIX), STAMP)
    stored.put(metrics, encode_metrics_file(trials))
    stored.put(keys.evaluation_trace(PREFIX, STAMP), trace_csv(*map(lap_rows, range(3))))
    run = RunRecord(
        **{"run_id": 0, "session": "s", "bucket": "bucket", "prefix": PREFIX},
        **{"world": "reinvent_base", "state": "finished", "pid": 4242, "pid_started": 1.0},
        **{"started_at": 1_000_000.0, "ended_at": 1_000_060.0, "exit_code": 0},
        workers=[WorkerRecord("trainer", 4243, 0)],
    )
    run.write(working_folder / "data" / "runs" / "0")
    return working_folder


def check(text):
    """Each line that has a lap time says how many resets, and no number of laps is of others."""
    for line in text.splitlines():
        assert "reset" in line or not TIME.search(line), line
        assert not HIDDEN.search(line), line


def numbers(value):
    """All objects in an answer."""
    if isinstance(value, dict):
        yield value
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            yield from numbers(inner)


def check_answer(answer):
    """No best lap, and each lap time stands beside its resets."""
    for each in numbers(answer):
        assert each.get("best_lap_s") is None, each
        assert not each.get("clean"), each
        if each.get("lap_s") or each.get("seconds"):
            assert each["resets"] == RESETS
        for text in each.values():
            if isinstance(text, str):
                check(text)


@pytest.mark.parametrize(
    "command",
    [
        "history",
        f"history show {PREFIX}",
        f"history tree {PREFIX}",
        f"history compare {PREFIX} {PREFIX}",
        "history --csv -",
        "list-models",
        "list-checkpoints",
        "analyze",
        "status",
        "summary",
        "video --gif --seconds 1 --policy none",
    ],
)
def test_no_command_shows_a_lap_without_its_resets(dr, weak, capsys, command):
    assert dr(*command.split()) == 0
    said = capsys.readouterr()
    check(said.out)
    check(said.err)

    if "video" in command:
        assert "Finished: 8.07 s = 5.07 driven + 3.00 penalty, 9 resets" in said.out
    if "csv" in command or "video" in command:
        return
    assert dr(*command.split(), "--json") == 0
    check_answer(json.loads(capsys.readouterr().out.splitlines()[-1]))


@pytest.mark.parametrize(
    "path",
    [
        "/api/models",
        f"/api/model/evaluations?prefix={PREFIX}",
        f"/api/model/checkpoints?prefix={PREFIX}",
        f"/api/model/curve?prefix={PREFIX}",
        f"/api/models/family?prefix={PREFIX}",
        f"/api/play/traces?model={PREFIX}",
    ],
)
def test_no_answer_to_a_page_has_a_lap_without_its_resets(weak, path):
    base = "http://127.0.0.1:8100"
    with TestClient(build_app(weak, None), base_url=base, headers={"origin": base}) as client:
        answer = client.get(path)

    assert answer.status_code == 200
    check_answer(answer.json())


def test_a_page_sums_up_an_evaluation_by_its_clean_laps(weak):
    base = "http://127.0.0.1:8100"
    with TestClient(build_app(weak, None), base_url=base, headers={"origin": base}) as client:
        [one] = client.get(f"/api/model/evaluations?prefix={PREFIX}").json()["evaluations"]

    assert one["summary"].startswith("0 of 3 laps clean (27 resets), 3 finished")
    assert (one["clean_laps"], one["complete_laps"], one["best_lap_s"]) == (0, 3, None)
