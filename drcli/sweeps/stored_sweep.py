"""The record of a sweep in the bucket."""

from collections.abc import Mapping

from drcli.base.errors import SettingsError, refuse
from drcli.bucket.bucket import Bucket, find_record
from drcli.model.model_prefix import is_used, wipe
from drcli.model.model_store import ModelStore
from drcli.sweeps import sweep_record
from drcli.sweeps.sweep_file import SweepFile
from drcli.sweeps.sweep_record import SweepRecord, TrialRecord
from drcli.sweeps.trials import Trial


def put_sweep(bucket: Bucket, record: SweepRecord) -> None:
    bucket.put(sweep_record.sweep_key(record.name), record.encode())


def read_sweep(bucket: Bucket, name: str) -> SweepRecord | None:
    """None without a record; raises StorageError for an unreadable one."""
    return find_record(bucket, sweep_record.sweep_key(name), SweepRecord.decode)


def refuse_other_trials(record: SweepRecord, sweep: SweepFile, trials: list[Trial]) -> None:
    """Raises ProblemsError for other trainings than recorded."""
    before = {trial.name: dict(trial.varied) for trial in record.trials}
    now = {trial.name: dict(trial.varied) for trial in trials}
    if before != now:
        other = sorted(name for name in before.keys() | now if before.get(name) != now.get(name))
        what = f"vary or settings have changed since the sweep {record.name} began: {other[0]} "
        what += "would be another training."
        remedy = "Give the new one another name; -w would delete the models of the old one."
        refuse([sweep.problem(("vary",), what, remedy)])


def refuse_used_models(bucket: Bucket, trials: list[Trial]) -> None:
    """Raises SettingsError for models that are not of the sweep."""
    for trial in trials:
        if is_used(ModelStore(bucket, trial.name)):
            raise SettingsError(
                f"s3://{bucket.name}/{trial.name} exists, and is not of this sweep.",
                remedy="Give the sweep another name.",
            )


def varied_now(trial: TrialRecord) -> Mapping[str, str]:
    """With what a population has changed."""
    changed = {key: f"{value:g}" for key, value in trial.hyperparameters.items()}
    return {**trial.varied, **changed}


def wipe_sweep(bucket: Bucket, record: SweepRecord) -> None:
    """Deletes the models, and the record last."""
    for trial in record.trials:
        for prefix in [
            trial.name,
            *(copy_of(trial, check) for check in range(1, 1 + record.checks)),
        ]:
            wipe(ModelStore(bucket, prefix))
    bucket.delete([sweep_record.sweep_key(record.name)])


def copy_of(trial: TrialRecord, check: int) -> str:
    """Prefix of a copy's model."""
    return f"{trial.name}-g{check + 1}"
