"""A training that goes on whatever breaks, and an auditor that would notice if it did not."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drcli.bucket.connect import FolderBucket
from drcli.model import keys
from fault_audit import Audit
from fault_machine import PREFIX
from fault_schedule import SHORT, parse

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]

WORKERS = 1


def test_a_training_reaches_its_goal_through_faults_and_leaves_a_sound_model(with_faults):
    verdict, _ = with_faults

    assert verdict.findings == [], f"Replay it with scripts/faults --replay:\n{SHORT}"
    assert verdict.skipped == []
    assert sum(verdict.injected.values()) == len(parse(SHORT))
    assert verdict.iterations == 11


def _last_trace(folder: Path) -> Path:
    return folder / keys.training_trace(PREFIX, 10, workers=WORKERS)


def _change(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def _changed_json(key: str, change: Callable[[Any], object]) -> Callable[[Path], None]:
    def do(folder: Path) -> None:
        content = json.loads((folder / key).read_text())
        change(content)
        (folder / key).write_text(json.dumps(content))

    return do


def _without_weights(folder: Path) -> None:
    pointer = (folder / keys.coach_checkpoint(PREFIX)).read_text()
    (folder / keys.checkpoint_tensors(PREFIX, pointer)).unlink()


def _without_optimizer(folder: Path) -> None:
    for path in (folder / keys.model_folder(PREFIX)).glob("*.optimizer.safetensors"):
        path.unlink()


def _driven(metrics: Any) -> Any:
    """The last training episode."""
    return [row for row in metrics["metrics"] if row["phase"] == "training"][-1]


METRICS = keys.training_metrics(keys.metrics_prefix(PREFIX))
HISTORY, LEARNER = keys.history(PREFIX), keys.learner_metrics(PREFIX)

DEFECTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a lost trace": (lambda f: _last_trace(f).unlink(), "Iteration 10: the history"),
    "a doubled row of a trace": (
        lambda f: _change(_last_trace(f), lambda t: t + t.splitlines()[-1] + "\n"),
        "Iteration 10: the history",
    ),
    "a cut trace": (
        lambda f: _change(_last_trace(f), lambda t: t[: len(t) // 2]),
        "Iteration 10: the history",
    ),
    "a lost episode": (
        _changed_json(METRICS, lambda m: m["metrics"].remove(_driven(m))),
        "the metrics have trials",
    ),
    "a doubled episode": (
        _changed_json(METRICS, lambda m: m["metrics"].append(_driven(m))),
        "have episodes twice",
    ),
    "another reward": (
        _changed_json(METRICS, lambda m: _driven(m).update(reward_score=10_000)),
        "are not those of the trace",
    ),
    "a clock that goes back": (
        _changed_json(METRICS, lambda m: m["metrics"][-1].update(metric_time=0)),
        "goes back 1 times",
    ),
    "metrics that are no JSON": (
        lambda f: _change(f / METRICS, lambda t: t[:-1]),
        "TrainingMetrics.json is damaged",
    ),
    "a lost iteration": (
        _changed_json(HISTORY, lambda h: h["iterations"].pop(4)),
        "The history has iterations",
    ),
    "a doubled iteration": (
        _changed_json(HISTORY, lambda h: h["iterations"].insert(4, h["iterations"][4])),
        "The history has iterations",
    ),
    "a total that is no sum": (
        _changed_json(HISTORY, lambda h: h["iterations"][5].update(total_steps=7)),
        "has 7 steps in total",
    ),
    "a lost row of the learner": (
        lambda f: _change(f / LEARNER, lambda t: "\n".join(t.splitlines()[:-1]) + "\n"),
        "has no row of iteration 10",
    ),
    "a doubled row of the learner": (
        lambda f: _change(f / LEARNER, lambda t: t + t.splitlines()[-1] + "\n"),
        "rows of 11 iterations",
    ),
    "lost weights": (_without_weights, "damaged"),
    "a lost optimizer": (_without_optimizer, "no optimizer state"),
    "a rollout that is left": (
        lambda f: _write(f / keys.rollout_manifest(PREFIX, 10, 0)),
        "Rollouts are left",
    ),
}


def _write(path: Path) -> None:
    path.parent.mkdir(parents=True)
    path.write_text("{}")


@pytest.mark.parametrize("defect", DEFECTS)
def test_the_auditor_finds_what_is_lost_doubled_or_damaged(with_faults, tmp_path, defect):
    make, sentence = DEFECTS[defect]
    shutil.copytree(with_faults[1], tmp_path / "bucket")
    make(tmp_path / "bucket")

    findings = Audit(FolderBucket(tmp_path / "bucket"), PREFIX, WORKERS, ended=True).run()

    assert any(sentence in finding for finding in findings), findings


def test_the_auditor_finds_nothing_in_a_sound_model(model):
    assert Audit(model, PREFIX, WORKERS, ended=True).run() == []
