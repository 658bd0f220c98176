"""Lists a model's checkpoints with their evaluations."""

from dataclasses import dataclass, field
from typing import Literal

from drcli.base.errors import SettingsError
from drcli.config.bucket_config import ModelConfig
from drcli.config.checkpoint_words import CheckpointWord
from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.laps import Laps
from drcli.exchange.milestone_record import KINDS, MilestoneKind
from drcli.exchange.phase import is_untaught
from drcli.models.checkpoint_choice import ModelCheckpoints
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.checkpoints import CheckpointStore
from drcli.store.model_kind import is_tensorflow, what_helps
from drcli.store.reconstruct import readable_evaluations
from drcli.store.repair import Model, find_damage, readable_history


@dataclass(frozen=True)
class ListedCheckpoint:
    """A checkpoint that is there.

    Attributes:
        number: What --checkpoint takes.
        name: Such as `12_Step-7824.ckpt`.
        words: The words that also choose it: last, best, first-lap, three-laps, best-lap.
        every: Whether it is kept because of DR_TRAIN_KEEP_EVERY.
        episodes: Episodes of its evaluation; 0 without one.
        laps: Clean laps among them: an episode ends at the first violation.
        progress: Their mean, percent of a lap; None without an evaluation.
        best_lap_s: Fastest clean lap, simulated seconds; None without one.
        size_bytes: All its files.
        problem: What is wrong with it; empty if nothing is known.
        form: `tensorflow` for a checkpoint of DeepRacer-for-Cloud or a console, else `drcli`.
        median_s: Median time of the clean laps; None if unknown.
        untaught: Whether its camera policy has not learned yet, because a teacher comes first.
    """

    number: int
    name: str
    words: list[CheckpointWord]
    every: bool
    episodes: int
    laps: int
    progress: float | None
    best_lap_s: float | None
    size_bytes: int
    problem: str = ""
    form: Literal["drcli", "tensorflow"] = "drcli"
    median_s: float | None = None
    untaught: bool = False


@dataclass(frozen=True)
class MilestoneEntry:
    """A milestone that was reached.

    Attributes:
        word: first-lap, three-laps or best-lap.
        checkpoint: Name of its checkpoint.
        laps: Clean laps of its evaluation.
        episodes: Episodes of its evaluation.
        best_lap_s: Fastest clean lap, simulated seconds.
        kept: Whether the checkpoint is still there.
    """

    word: MilestoneKind
    checkpoint: str
    laps: int
    episodes: int
    best_lap_s: float
    kept: bool


@dataclass(frozen=True)
class CheckpointList:
    """The checkpoints of a model.

    Attributes:
        model: As s3://bucket/prefix.
        checkpoints: All that are there, oldest first.
        milestones: Those that were reached, also by a deleted checkpoint.
        not_reached: The words of the others.
        size_bytes: Of all checkpoints.
        damaged: What is wrong with each damaged object, and what to do about it; what the list
            needs is reconstructed as far as possible.
    """

    model: str
    checkpoints: list[ListedCheckpoint]
    milestones: list[MilestoneEntry]
    not_reached: list[MilestoneKind]
    size_bytes: int
    damaged: list[str] = field(default_factory=list)


def list_checkpoints(
    config: ModelConfig, bucket: Bucket, prefix: str, *, check: bool = False
) -> CheckpointList:
    """List the checkpoints of a model; with `check`, their files are compared.

    Raises:
        SettingsError: There is no such model.
    """
    if not keys.is_valid_prefix(prefix):
        raise SettingsError(
            f"{prefix!r} is not the prefix of a model.",
            remedy="List the models with `dr-list-models`.",
        )
    model = Model.of(config, bucket, prefix)
    has = ModelCheckpoints.read(model)
    if not has.names:
        raise SettingsError(f"{has.url} has no checkpoint.", remedy=what_helps(bucket, prefix))
    history, _ = readable_history(model)
    results = readable_evaluations(bucket, prefix).values()
    # By number: where driving and learning overlap, an older one drove the iteration.
    evaluated = {
        record.iteration: (
            [*record.evaluation_progress, *record.confirmation_progress],
            [*record.evaluation_lap_s, *record.confirmation_lap_s],
        )
        for record in history
    }
    for result in results:
        episodes = result.on("training")
        number = checkpoint_name(result.checkpoint).number
        evaluated[number] = (episodes.progress, episodes.lap_s)
    # The record of a milestone has the numbers of an evaluation that the learning curve has lost.
    marked = {found.name: found for _, found in has.milestones.reached()}
    sizes = _sizes(has)
    store = CheckpointStore(bucket, prefix)
    spaced = set(has.milestones.spaced)
    there = {info.key for info in has.listed}
    listed = []
    for name in has.names:
        progress, lap_s = evaluated.get(name.number, ([], []))
        known = marked.get(name)
        if known is None or progress:
            seen = len(progress), len(lap_s), _mean(progress), min(lap_s, default=None)
        else:
            seen = known.episodes, known.laps, known.progress, known.best_lap_s
        untaught = is_untaught(history, name.number)
        words = has.words_for(name)
        listed.append(
            ListedCheckpoint(
                number=name.number,
                name=str(name),
                words=[word for word in words if word != "best" or not untaught],
                every=str(name) in spaced,
                episodes=seen[0],
                laps=seen[1],
                progress=seen[2],
                best_lap_s=seen[3],
                size_bytes=sizes[name],
                problem=_problem(has, store, name, check=check),
                form="tensorflow" if is_tensorflow(there, prefix, str(name)) else "drcli",
                median_s=Laps(len(progress), lap_s).median_s,
                untaught=untaught,
            )
        )
    reached = [
        MilestoneEntry(
            kind,
            found.checkpoint,
            found.laps,
            found.episodes,
            found.best_lap_s,
            found.name in has.names,
        )
        for kind, found in has.milestones.reached()
    ]
    words_known = {entry.word for entry in reached}
    return CheckpointList(
        has.url,
        listed,
        reached,
        [kind for kind in KINDS if kind not in words_known],
        sum(sizes.values()),
        find_damage(model),
    )


def _mean(progress: list[float]) -> float | None:
    return sum(progress) / len(progress) if progress else None


def _sizes(has: ModelCheckpoints) -> dict[CheckpointName, int]:
    sizes = dict.fromkeys(has.names, 0)
    graphs = {keys.checkpoint_graph(has.prefix, name.number): name for name in has.names}
    for info in has.listed:
        name = keys.checkpoint_of(has.prefix, info.key) or graphs.get(info.key)
        if name is not None:
            sizes[name] += info.size_bytes
    return sizes


def _problem(
    has: ModelCheckpoints, store: CheckpointStore, name: CheckpointName, *, check: bool
) -> str:
    missing = has.missing_parts(str(name))
    if missing:
        return f"{missing[0].rpartition('/')[2]} is missing."
    tensors = keys.checkpoint_tensors(has.prefix, str(name))
    if not check or not any(info.key == tensors for info in has.listed):
        return ""
    try:
        store.load(str(name))
    except (ObjectMissing, ObjectDamaged) as error:
        return str(error)
    return ""
