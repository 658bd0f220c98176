"""A race of two ready-made models, whose queue is killed: real commands, workers and bucket."""

import csv
import json
import os
import signal

import pytest

from drcli.model import race_keys


def test_a_race_survives_the_death_of_its_queue_and_has_a_winner(workspace):
    workspace.write_run_env(DR_WORLD_NAME="bean", DR_EVAL_MAX_RESETS=100)
    workspace.put_ready_made("safe", "fast")
    bucket = workspace.bucket()

    def dr(*words: str) -> dict:
        answer = workspace.run("race", *words, "--json")
        assert answer.returncode == 0, answer.stderr
        report: dict = json.loads(answer.stdout.splitlines()[-1])
        return report

    dr("create", "Friday Cup", "--laps", "1", "--seed", "3")
    dr("submit", "friday-cup", "--racer", "Ann", "--prefix", "safe")
    dr("submit", "friday-cup", "--racer", "Bob", "--prefix", "fast")
    started = dr("run", "friday-cup", "-q", "--no-video")
    workspace.wait_for(lambda: bucket.list(race_keys.result("friday-cup", "")[:-5]), "a result")
    os.kill(started["pid"], signal.SIGKILL)
    killed = dr("show", "friday-cup")
    dr("close", "friday-cup")
    report = dr("run", "Friday Cup", "--no-video")
    dr("export", "friday-cup", "--csv", "cup.csv", "--html", "cup.html")

    assert len(killed["queue"]) == 2
    assert killed["runner"] == ""
    assert [row["racer"] for row in report["leaderboard"]] == ["Bob", "Ann"]
    assert report["state"] == "finished"
    assert report["winner"] == "Bob"
    fast, safe = report["leaderboard"]
    assert 4.0 < fast["best_lap_s"] < safe["best_lap_s"] < 20.0
    assert safe["gap_s"] == pytest.approx(safe["best_lap_s"] - fast["best_lap_s"])
    with (workspace.folder / "cup.csv").open() as file:
        assert [row["racer"] for row in csv.DictReader(file)] == ["Bob", "Ann"]
    assert "Winner: Bob." in (workspace.folder / "cup.html").read_text()
    assert not list(workspace.folder.glob("data/runs/0/evaluations/*/running.json"))
