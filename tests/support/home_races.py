"""A bucket with models, and races whose laps exist only on paper."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from drcli.base.errors import DrError
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model import keys, race_keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.races.organise import create_race
from drcli.races.race_options import RaceOptions
from drcli.races.race_queue import run_queue
from drcli.races.race_records import DrivenLap
from drcli.races.submissions import submit
from drcli.run.evaluation_plan import EvaluationPlan
from drcli.run.evaluation_report import EvaluationReport, TrialReport
from memory_bucket import MemoryBucket
from racer import ACTIONS

RACE = "cup"
COMPLETE = "Lap complete"


def lap(lap_s: float, *, status: str = COMPLETE, off_track: int = 0) -> DrivenLap:
    """One lap."""
    progress = 100.0 if status == COMPLETE else 40.0
    return DrivenLap(lap_s, progress, status, off_track)


@dataclass
class Home:
    """A racer's folder, a bucket in memory, and what each model is to drive.

    Attributes:
        laps: Lap times by model, or trials; a text fails with it.
        driven: The plans that were driven, in order.
        before: Called with the model before it drives.
    """

    folder: Path
    bucket: MemoryBucket
    laps: dict[str, Any] = field(default_factory=dict)
    driven: list[EvaluationPlan] = field(default_factory=list)
    before: Callable[[str], None] = lambda model: None

    @property
    def settings(self) -> Settings:
        return load_settings(self.folder, environ={})

    def put_model(self, prefix: str, number: int = 5, sensor: str = "FRONT_FACING_CAMERA") -> None:
        """Lay down a model with one checkpoint."""
        import json

        store = CheckpointStore(ModelStore(self.bucket, prefix))
        store.save(number, 100 * number, b"weights of %s" % prefix.encode())
        metadata = {
            "action_space": ACTIONS,
            "action_space_type": "discrete",
            "sensor": sensor.split(),
            "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
            "training_algorithm": "clipped_ppo",
            "version": "5",
        }
        self.bucket.put(keys.model_metadata(prefix), json.dumps(metadata).encode())

    def race(self, **rules: Any) -> str:
        """Make a race of two laps."""
        wanted = RaceOptions("Cup", **{"max_laps": 2, "seed": 1, **rules})
        return create_race(self.settings, self.bucket, wanted).race

    def submit(self, model: str, racer: str = "", **options: Any) -> str:
        """Submit a model by a racer who is called like it."""
        racer = racer or model.capitalize()
        options = {"prefix": model, "racer": racer, **options}
        return submit(self.settings, self.bucket, RACE, **options).submission

    def run(self, **options: Any) -> Any:
        """Drive the queue."""
        options = {"video": False, **options}
        return run_queue(self.settings, self.bucket, RACE, **options)

    def drive(self, plan: EvaluationPlan, *_: object) -> EvaluationReport:
        """Stands for the worker process of an evaluation."""
        self.driven.append(plan)
        config = plan.job.config
        names = [config.model.prefix]
        if config.race().race_type == "HEAD_TO_MODEL":
            names.append(config.evaluation.eval_opp_s3_model_prefix)
        reports = [self._report(name, plan) for name in names]
        if len(reports) == 1:
            return reports[0]
        from dataclasses import replace

        return replace(reports[0], opponent=reports[1])

    def _report(self, prefix: str, plan: EvaluationPlan) -> EvaluationReport:
        model = race_keys.submitted_model(prefix)
        self.before(model)
        found = self.laps.get(model, [10.0, 10.0])
        if isinstance(found, DrError):
            raise found
        trials = [
            time
            if isinstance(time, TrialReport)
            else TrialReport(number, 100.0, time, COMPLETE, 0, 0, 0)
            if time > 0
            else TrialReport(number, 30.0, -time, "Off track", 1, 0, 0)
            for number, time in enumerate(found, start=1)
        ]
        return EvaluationReport(
            prefix=prefix,
            world="bean",
            checkpoint="5.ckpt",
            trials=trials,
            simtrace=plan.simtrace,
            metrics=plan.metrics,
        )


def home_in(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    """A folder and a bucket with three models, and no race."""
    (working_folder / "run.env").write_text(
        "DR_WORLD_NAME=bean\nDR_LOCAL_S3_MODEL_PREFIX=ann\nDR_RACER_NAME=Ann\n"
    )
    found = Home(working_folder, MemoryBucket())
    for name in ("ann", "bob", "cem"):
        found.put_model(name)
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: found.bucket)
    monkeypatch.setattr("drcli.races.race_queue.run_evaluation", found.drive)
    return found
