"""The race types as their user meets them: real commands, real worker processes, a real bucket."""

import csv
import json

import pytest

pytestmark = pytest.mark.nightly

REWARD = """    assert len(params["objects_location"]) == 3, params["objects_location"]
    ahead = params["closest_objects"][1]
    near = params["objects_distance"][ahead] - params["projection_distance"]
    return 1.0 if params["is_crashed"] or near > 0.5 else 0.5
"""


def test_a_model_is_trained_among_obstacles_and_raced_against_itself(workspace, log_guru):
    workspace.hyperparameters["term_cond_max_episodes"] = 1
    workspace.write_custom_files(REWARD)
    obstacles = {
        "DR_RACE_TYPE": "OBJECT_AVOIDANCE",
        "DR_OA_OBJECT_POSITIONS": '"0.07,-1;0.3,1;0.6,1"',
        "DR_ENABLE_DOMAIN_RANDOMIZATION": True,
        "DR_SIM_LATENCY": 0.05,
        "DR_EVAL_NUMBER_OF_TRIALS": 1,
    }
    workspace.write_run_env(**obstacles)

    trained = workspace.run("start-training", "--json")
    avoided = workspace.run("evaluate", "--json")
    workspace.write_run_env(
        DR_RACE_TYPE="HEAD_TO_MODEL",
        DR_EVAL_OPP_S3_MODEL_PREFIX=workspace.prefix,
        DR_EVAL_NUMBER_OF_TRIALS=1,
    )
    raced = workspace.run("evaluate", "--opp-runtime", "pb", "--json")

    assert trained.returncode == 0, trained.stderr
    assert avoided.returncode == 0, avoided.stderr
    assert raced.returncode == 0, raced.stderr
    report = json.loads(raced.stdout.splitlines()[-1])
    assert report["prefix"] == report["opponent"]["prefix"] == workspace.prefix
    assert (report["runtime"], report["opponent"]["runtime"]) == ("torch", "pb")
    bucket = workspace.model.parent
    own, other = (bucket / r["simtrace"] for r in (report, report["opponent"]))
    starts = [next(csv.DictReader(trace.read_text().splitlines())) for trace in (own, other)]
    assert float(starts[0]["Y"]) != pytest.approx(float(starts[1]["Y"]), abs=0.1)
    assert float(starts[1]["progress"]) < 0 < float(starts[0]["progress"])
    beside = [trace.parents[1] / "recording.json" for trace in (own, other)]
    colors = [json.loads(path.read_text()) for path in beside]
    assert colors[0]["color"] == colors[1]["other_color"]
    assert colors[1]["color"] == colors[0]["other_color"] == "Orange"
    assert len(json.loads((bucket / report["opponent"]["metrics"]).read_text())["metrics"]) == 1
    assert len(log_guru(workspace.log("sim-0")).episodes) == 4


def test_more_obstacles_than_fit_are_refused_before_anything_starts(workspace):
    workspace.write_run_env(DR_RACE_TYPE="OBJECT_AVOIDANCE", DR_OA_NUMBER_OF_OBSTACLES=30)

    refused = workspace.run("start-training")

    assert refused.returncode == 3
    assert "DR_OA_NUMBER_OF_OBSTACLES" in refused.stderr
    assert "8 would fit" in refused.stderr
    assert workspace.record() == {}
