"""Takes submissions, and changes the queue.

A submission is a copy of a checkpoint: the racer can train on or delete the model, and nobody
can change it.
"""

import socket
import time
from dataclasses import dataclass, replace
from typing import Annotated

from drcli.base.errors import BadValue, ProblemsError, SettingsError, shown
from drcli.base.json_record import RecordError
from drcli.base.report import counted
from drcli.bucket.bucket import Bucket
from drcli.config.settings import Settings
from drcli.config.value_types import parse_checkpoint
from drcli.model import keys, race_keys
from drcli.model.checkpoint_choice import OUR_PARTS, take_choice
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import own_files
from drcli.model.files.sensors import usual_names
from drcli.model.model_prefix import what_helps
from drcli.model.model_store import ModelStore
from drcli.races.lap_ranking import same_racer
from drcli.races.organise import show_race
from drcli.races.queue_lease import runner_of
from drcli.races.race_options import checked_name
from drcli.races.race_records import QueueOrder, RaceRules, RaceSubmission
from drcli.races.race_report import RaceReport
from drcli.races.standings import date_text, queue_of, state_of
from drcli.races.stored_race import StoredRace, new_name, put, read_race, submission_id
from drcli.records.checkpoint import CheckpointName
from drcli.records.scores import Score, encode_single

_PARTS = (*OUR_PARTS, *keys.TENSORFLOW_PARTS)


@dataclass(frozen=True)
class SubmissionReport:
    """A submission that was taken."""

    race: Annotated[str, "Id of the race."]
    submission: Annotated[str, "Its id."]
    racer: Annotated[str, "Who submitted it."]
    model: Annotated[str, "Prefix of the model."]
    checkpoint: Annotated[str, "Name of the checkpoint."]
    waiting: Annotated[int, "Runs up to and with it."]
    left: Annotated[int | None, "How many more the racer may submit; None for any number."]
    queue: Annotated[bool, "Whether a process drives the queue now."]

    def __str__(self) -> str:
        number = self.checkpoint.partition("_")[0]
        left = "" if self.left is None else f" {self.racer} has {self.left} left."
        driven = "is driven now" if self.queue else "waits for `dr-race run`"
        return (
            f"Submitted checkpoint {number} of {self.model} for {self.racer} as {self.submission}; "
            f"{counted(self.waiting, 'run')} to drive, the queue {driven}.{left}"
        )


def submit(
    settings: Settings,
    bucket: Bucket,
    race: str,
    *,
    prefix: str | None = None,
    checkpoint: str = "best",
    racer: str | None = None,
    now_s: float | None = None,
) -> SubmissionReport:
    """Submit a checkpoint, as in DR_EVAL_CHECKPOINT; None: the settings.

    Raises:
        SettingsError: The race is closed, the racer has none left, or the model is missing or does
            not fit.
    """
    now = time.time() if now_s is None else now_s
    stored = read_race(bucket, race)
    name = checked_name(settings.racer_name if racer is None else racer, "the racer")
    model = settings.model_prefix if prefix is None else prefix.strip("/")
    if not keys.is_valid_prefix(model):
        raise SettingsError(
            f"{shown(model)} cannot be the prefix of a model.",
            remedy="Name one of those that `dr-list-models` shows.",
        )
    try:
        choice = parse_checkpoint(checkpoint)
    except BadValue as error:
        raise SettingsError(
            f"--checkpoint {shown(checkpoint)} {error}.", remedy=error.remedy
        ) from None
    _refuse_late(stored, now)
    _refuse_too_many(stored, name)
    chosen = take_choice(ModelStore.of(settings.model, bucket, model), choice).name
    _check_model(bucket, model, chosen, stored.rules, race)
    _refuse_twice(stored, model, chosen)
    taken = new_name(bucket, race)
    _copy(bucket, model, chosen, race_keys.model(race, taken, model))
    record = RaceSubmission(name, model, chosen, now, socket.gethostname())
    put(bucket, race_keys.submission(race, taken), record)  # last: nobody drives half a copy
    return _taken(bucket, race, taken, record)


def withdraw(bucket: Bucket, race: str, submission: str) -> RaceReport:
    """Remove a submission and its results.

    Raises:
        SettingsError: No such race or submission.
    """
    stored = read_race(bucket, race)
    name = stored.find(submission)
    bucket.delete([race_keys.submission(race, name)])  # first: without it, the rest is nothing
    gone = [race_keys.order(race, name)]
    gone += [info.key for info in bucket.list(race_keys.models(race, name))]
    for result in stored.results:
        if name in result.split("_"):
            gone.append(race_keys.result(race, result))
            gone += [race_keys.video(race, video) for video in video_names(result)]
    bucket.delete(gone)
    return show_race(bucket, race)


def move(bucket: Bucket, race: str, submission: str, place: int) -> RaceReport:
    """Put a waiting submission at a place, from 1; in pairs, it orders them until a draw.

    Raises:
        SettingsError: It does not exist or wait.
    """
    stored = read_race(bucket, race)
    name = stored.find(submission)
    if stored.draw is not None:
        raise SettingsError(
            f"The bracket of race {race} is drawn, so its order cannot be changed.",
            remedy="Drive it with `dr-race run`, or withdraw a submission.",
        )
    if place < 1:
        raise SettingsError(
            f"There is no place {place} in a queue.", remedy="Write 1 for the next to be driven."
        )
    waiting = _waiting(stored, bucket)
    if name not in waiting:
        raise SettingsError(
            f"Submission {submission_id(name)} of race {race} does not wait in the queue.",
            remedy=f"Let it be driven again with `dr-race restart {race} {submission_id(name)}`.",
        )
    order = [each for each in waiting if each != name]
    order.insert(min(place, len(waiting)) - 1, name)
    for each, number in _places(stored, waiting, order).items():
        record = replace(_order(stored, each), place=number)
        put(bucket, race_keys.order(race, each), record)
    return show_race(bucket, race)


def restart(bucket: Bucket, race: str, submission: str) -> RaceReport:
    """Drive a submission again, in its old place; in pairs, all of its pairs.

    Raises:
        SettingsError: No such race or submission.
    """
    stored = read_race(bucket, race)
    name = stored.find(submission)
    order = _order(stored, name)
    put(bucket, race_keys.order(race, name), replace(order, restarts=order.restarts + 1))
    return show_race(bucket, race)


def video_names(run: str) -> list[str]:
    return [run, f"{run}-2"] if "_" in run else [run]


def _order(stored: StoredRace, name: str) -> QueueOrder:
    return stored.orders.get(name) or QueueOrder(stored.place(name))


def _waiting(stored: StoredRace, bucket: Bucket) -> list[str]:
    runs = queue_of(stored, runner_of(bucket, stored.race))
    return list(dict.fromkeys(name for run in runs for name in run))


def _places(stored: StoredRace, before: list[str], after: list[str]) -> dict[str, int]:
    numbers = sorted(stored.place(name) for name in before)
    for index in range(1, len(numbers)):
        numbers[index] = max(numbers[index], numbers[index - 1] + 1)
    return {
        name: number
        for name, number in zip(after, numbers, strict=True)
        if stored.place(name) != number
    }


def _refuse_late(stored: StoredRace, now_s: float) -> None:
    rules, state = stored.rules, state_of(stored.rules, now_s)
    if state == "closed" and rules.closes_at is not None:
        raise SettingsError(
            f"Race {stored.race} was closed at {date_text(rules.closes_at)}.",
            remedy=f"Ask its organiser to open it again with `dr-race open {stored.race}`.",
        )
    if state == "scheduled" and rules.opens_at is not None:
        raise SettingsError(
            f"Race {stored.race} opens at {date_text(rules.opens_at)}.",
            remedy=f"Submit then, or open it now with `dr-race open {stored.race}`.",
        )
    if stored.draw is not None:
        raise SettingsError(
            f"The bracket of race {stored.race} is drawn, so nobody can join it.",
            remedy="Make another race with `dr-race create NAME`.",
        )


def _refuse_too_many(stored: StoredRace, racer: str) -> None:
    most = stored.rules.max_submissions
    own = [
        submission_id(name)
        for name, submission in stored.submissions.items()
        if same_racer(submission.racer) == same_racer(racer)
    ]
    if most and len(own) >= most:
        raise SettingsError(
            f"{racer} has submitted {', '.join(own)} to race {stored.race}, and its rules allow "
            f"{most} for each racer.",
            remedy=f"Withdraw one with `dr-race withdraw {stored.race} {own[-1]}`.",
        )


def _refuse_twice(stored: StoredRace, model: str, checkpoint: str) -> None:
    for name, submission in stored.submissions.items():
        if (submission.model, submission.checkpoint) == (model, checkpoint):
            raise SettingsError(
                f"Checkpoint {checkpoint} of {model} is submission {submission_id(name)} of race "
                f"{stored.race} already, and would drive the same laps.",
                remedy="Submit another checkpoint with --checkpoint, or `dr-race restart "
                f"{stored.race} {submission_id(name)}`.",
            )


def _check_model(bucket: Bucket, model: str, checkpoint: str, rules: RaceRules, race: str) -> None:
    store = ModelStore(bucket, model)
    url = f"s3://{bucket.name}/{model}"
    data = own_files(store, checkpoint).get(keys.MODEL_METADATA_FILE)
    if data is None:
        raise SettingsError(
            f"{url} has no trained model: {keys.model_metadata(model)} is missing.",
            remedy=what_helps(store),
        )
    try:
        used = ModelMetadata.from_bytes(data, f"{url}/{checkpoint}: model_metadata.json").sensor
    except (ProblemsError, RecordError) as error:
        remedy = getattr(error, "remedy", "") or "Repair that file."
        raise SettingsError(str(error), remedy=remedy) from error
    wrong = [name for name in usual_names(used) if name not in rules.sensors]
    if rules.sensors and wrong:
        raise SettingsError(
            f"{url} uses {' and '.join(wrong)}, but race {race} allows only "
            f"{', '.join(rules.sensors)}.",
            remedy="Submit a model with these sensors.",
        )


def _copy(bucket: Bucket, model: str, checkpoint: str, target: str) -> None:
    wanted = CheckpointName.parse(checkpoint)
    found = [
        info.key
        for info in bucket.list(keys.model_folder(model))
        if keys.checkpoint_of(model, info.key) == wanted and info.key.endswith(_PARTS)
    ]
    if bucket.exists(keys.reward_function(model)):
        found.append(keys.reward_function(model))
    for key in found:
        copy = keys.folder(target) + key.removeprefix(keys.folder(model))
        bucket.put(copy, bucket.get(key))
    copies = {
        keys.MODEL_METADATA_FILE: keys.model_metadata(target),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(target),
    }
    for name, data in own_files(ModelStore(bucket, model), checkpoint).items():
        bucket.put(copies[name], data)
    bucket.put(keys.deepracer_checkpoints(target), encode_single(Score(checkpoint)))
    bucket.put(keys.coach_checkpoint(target), checkpoint.encode())


def _taken(bucket: Bucket, race: str, name: str, record: RaceSubmission) -> SubmissionReport:
    stored, runner = read_race(bucket, race), runner_of(bucket, race)
    runs = queue_of(stored, runner)
    before = [number for number, run in enumerate(runs, start=1) if name in run]
    most, racer = stored.rules.max_submissions, same_racer(record.racer)
    own = sum(same_racer(each.racer) == racer for each in stored.submissions.values())
    return SubmissionReport(
        race=race,
        submission=submission_id(name),
        racer=record.racer,
        model=record.model,
        checkpoint=record.checkpoint,
        waiting=max(before, default=0),
        left=max(0, most - own) if most else None,
        queue=bool(runner.session),
    )
