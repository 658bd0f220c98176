"""Finds the checkpoint that a word or a number chooses."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from drcli.base import errors
from drcli.base.errors import SettingsError
from drcli.bucket.bucket import Listing, ObjectDamaged, ObjectInfo, ObjectMissing
from drcli.config.value_types import WORDS, CheckpointChoice, CheckpointWord
from drcli.model import keys
from drcli.model.best_checkpoint import read_evaluation
from drcli.model.milestones import MilestoneKind, Milestones
from drcli.model.model_prefix import what_helps
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history, readable_milestones, readable_scores
from drcli.records.checkpoint import CheckpointName, checkpoint_name
from drcli.records.iteration import IterationRecord, Laps
from drcli.records.scores import Score, Scores
from drcli.records.stage import is_untaught

OUR_PARTS = (".safetensors", ".json")
MOST_LISTED = 12
NEVER_EVALUATED = "not evaluated by its training"
UNTAUGHT = "never evaluated, because only its teacher has learned until there"

_NEVER: dict[CheckpointWord, str] = {
    "first-lap": "no evaluation during its training has completed a lap",
    "three-laps": "no evaluation during its training has completed three laps",
    "best-lap": "no evaluation during its training has completed a lap",
}


class CheckpointGone(SettingsError):
    """The chosen checkpoint is missing or incomplete, maybe deleted by a training."""


@dataclass(frozen=True)
class Chosen:
    choice: CheckpointChoice
    score: Score
    parts: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.score.name

    @property
    def number(self) -> int:
        return checkpoint_name(self.name).number

    @property
    def line(self) -> str:
        """Scripts look for it: the reference's command writes it."""
        if self.choice == "last":
            return f"Latest checkpoint = {self.number}"
        if self.choice == "best":
            return f"Best checkpoint: {self.number}"
        return f"Chosen checkpoint: {self.number}"


@dataclass(frozen=True)
class ModelCheckpoints:
    model: ModelStore
    listed: Listing
    names: tuple[CheckpointName, ...]
    scores: Scores | None
    milestones: Milestones
    history: list[IterationRecord]
    damaged: tuple[str, ...]

    @staticmethod
    def read(model: ModelStore) -> "ModelCheckpoints":
        """Reconstructs damaged records, but writes nothing."""
        listed = model.bucket.list(keys.model_folder(model.prefix))
        found = {keys.checkpoint_of(model.prefix, info.key) for info in listed}
        scores, damaged = readable_scores(model)
        history, of_history = readable_history(model)
        milestones, of_milestones = readable_milestones(model, history)
        return ModelCheckpoints(
            model,
            listed,
            tuple(sorted(name for name in found if name is not None)),
            scores,
            milestones,
            history,
            (*damaged, *of_history, *of_milestones),
        )

    def words_for(self, name: CheckpointName) -> list[CheckpointWord]:
        found: list[CheckpointWord] = []
        if self.scores is not None:
            last, best = self.scores.last_checkpoint.name, self.scores.best_checkpoint.name
            found += ["last"] * (last == str(name))
            found += ["best"] * (best == str(name))
        found += [kind for kind, each in self.milestones.reached() if each.name == name]
        return found

    def missing_parts(self, name: str) -> list[str]:
        return missing_parts(self.listed, self.model.prefix, name)

    @property
    def summary(self) -> str:
        whole = [name for name in self.names if not self.missing_parts(str(name))]
        if not whole:
            return "It has no complete checkpoint."
        shown = self._few(whole)
        words = {name: self.words_for(name) for name in shown}
        texts = [
            f"{name.number} ({', '.join(words[name])})" if words[name] else f"{name.number}"
            for name in shown
        ]
        more = len(whole) - len(shown)
        rest = f", and {more} more (`dr-list-checkpoints {self.model.prefix}`)" if more else ""
        return f"It has {', '.join(texts)}{rest}."

    def _few(self, whole: list[CheckpointName]) -> list[CheckpointName]:
        if len(whole) <= MOST_LISTED:
            return whole
        marked = [name for name in whole if self.words_for(name)]
        others = [name for name in whole if name not in marked]
        return sorted([*marked, *others[-max(0, MOST_LISTED - len(marked)) :]])

    def choose(self, choice: CheckpointChoice, remedy: str = "") -> Chosen:
        """The complete checkpoint that a word or a number chooses.

        Raises:
            CheckpointGone: It is missing, incomplete, or was never reached.
            SettingsError: The model has no checkpoint.
        """
        model, scores = self.model, self.scores
        known = () if scores is None else (scores.best_checkpoint, scores.last_checkpoint)
        if choice == "last" or choice == "best":
            if scores is None:
                raise SettingsError(
                    f"No checkpoint file available at s3://{model.bucket.name}/"
                    f"{keys.deepracer_checkpoints(model.prefix)}. Exiting.",
                    remedy=what_helps(model),
                )
            score = scores.best_checkpoint if choice == "best" else scores.last_checkpoint
        elif not self.names:
            raise SettingsError(f"{model.url} has no checkpoint.", remedy=what_helps(model))
        else:
            found = (
                self._numbered(choice, remedy)
                if isinstance(choice, int)
                else self._reached(choice, remedy)
            )
            score = next((s for s in known if s.name == str(found)), Score(str(found)))
        missing = self.missing_parts(score.name)
        if missing:
            raise self._gone(f"s3://{model.bucket.name}/{missing[0]} is missing.", remedy)
        start = keys.checkpoint_part(model.prefix, score.name, "")
        parts = [info.key for info in self.listed if info.key.startswith(f"{start}.")]
        return Chosen(choice, score, tuple(key.removeprefix(start) for key in parts))

    def _numbered(self, number: int, remedy: str) -> CheckpointName:
        same = [name for name in self.names if name.number == number]
        if same:
            return ([name for name in same if not self.missing_parts(str(name))] or same)[-1]
        newest = self.names[-1].number
        if number > newest:
            raise self._gone(f"There is no checkpoint {number}: the newest is {newest}.", remedy)
        raise self._gone(f"Checkpoint {number} was deleted, or this copy never had it.", remedy)

    def _reached(self, word: MilestoneKind, remedy: str) -> CheckpointName:
        reached = self.milestones.reached()
        milestone = next((found for kind, found in reached if kind == word), None)
        if milestone is None:
            raise self._gone(f"There is no checkpoint {word}: {_NEVER[word]}.", remedy)
        if milestone.name not in self.names:
            number = milestone.name.number
            raise self._gone(
                f"Checkpoint {number}, which is {word}, is not there: it was deleted.", remedy
            )
        return milestone.name

    def _gone(self, why: str, remedy: str) -> CheckpointGone:
        return CheckpointGone(
            f"{self.model.url}: {why} {self.summary}",
            remedy=remedy
            or f"Choose one of these with --checkpoint N, or one of {', '.join(WORDS)}. If a "
            "training runs, try again.",
        )

    def sentence_about(self, chosen: Chosen, option: str = "--checkpoint") -> str:
        """Such as "Takes checkpoint 77 of m-1, the last: not evaluated by its training. ..."."""
        scores, of = self.scores, f"{chosen.number} of {self.model.prefix}"
        driven = _driven(self.model, self.history, chosen.score)
        if chosen.choice not in ("last", "best") or scores is None:
            return f"Takes checkpoint {of}: {driven}."
        word = "best" if chosen.choice == "last" else "last"
        other = scores.best_checkpoint if word == "best" else scores.last_checkpoint
        of_other = _driven(self.model, self.history, other)
        if other.name == chosen.name:
            unknown = of_other in (NEVER_EVALUATED, UNTAUGHT)
            if unknown and chosen.choice == "best":
                return f"Takes checkpoint {of}, the last, because none has been evaluated."
            words = "the last" if unknown else "the best and the last"
            return f"Takes checkpoint {of}, {words}: {driven}."
        if of_other == UNTAUGHT:
            return f"Takes checkpoint {of}, the {chosen.choice}: {driven}."
        return (
            f"Takes checkpoint {of}, the {chosen.choice}: {driven}. {option} "
            f"{word} takes {checkpoint_name(other.name).number}: {of_other}."
        )


def take_choice(model: ModelStore, choice: CheckpointChoice, *, remedy: str = "") -> Chosen:
    """As `ModelCheckpoints.choose`, but says which one it took."""
    checkpoints = ModelCheckpoints.read(model)
    chosen = checkpoints.choose(choice, remedy)
    errors.show(checkpoints.sentence_about(chosen))
    return chosen


def laps_of(model: ModelStore, history: Iterable[IterationRecord], name: str) -> Laps | None:
    number = checkpoint_name(name).number
    laps = next((record.all_laps for record in history if record.iteration == number), None)
    if laps is None:  # the learning curve may have no record of its iteration yet
        with suppress(ObjectMissing, ObjectDamaged):
            result = read_evaluation(model, number)
            if result.checkpoint == name:
                laps = result.on("training").laps
    return laps


def _driven(model: ModelStore, history: Iterable[IterationRecord], score: Score) -> str:
    laps = laps_of(model, history, score.name)
    if laps is not None:
        return str(laps)
    if score.avg_eval_metric is not None:  # of a copy, which comes without its history
        return f"score {score.avg_eval_metric:.1f} in its evaluation"
    if is_untaught(list(history), checkpoint_name(score.name).number):
        return UNTAUGHT
    return NEVER_EVALUATED


def missing_parts(listed: Iterable[ObjectInfo], prefix: str, name: str) -> list[str]:
    """Keys of missing files; those of our format if there are none."""
    there = {info.key for info in listed}
    ours, theirs = (
        [key for part in parts if (key := keys.checkpoint_part(prefix, name, part)) not in there]
        for parts in (OUR_PARTS, keys.TENSORFLOW_PARTS)
    )
    if not theirs:
        return []  # also where a conversion was cut off that began to write ours beside it
    is_tensorflow = len(ours) == len(OUR_PARTS) and len(theirs) < len(keys.TENSORFLOW_PARTS)
    return theirs if is_tensorflow else ours
