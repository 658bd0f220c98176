"""Lists a model's checkpoints with their evaluations."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Literal

from drcli.base import errors
from drcli.base.errors import SettingsError
from drcli.base.report import Col, Styled, View, bold, counted, size_text, table
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing, ObjectNewer
from drcli.config.run_config import ModelConfig
from drcli.config.value_types import CheckpointWord
from drcli.model import keys
from drcli.model.checkpoint_choice import OUR_PARTS, Chosen, ModelCheckpoints
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import own_files
from drcli.model.files.params_yaml import moved_training_parameters
from drcli.model.growing_file import read_complete
from drcli.model.milestones import KINDS, MilestoneKind, MilestoneReport
from drcli.model.model_prefix import is_tensorflow, what_helps
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_evaluations
from drcli.model.training_records import at_once
from drcli.records.checkpoint import CheckpointName, checkpoint_name
from drcli.records.iteration import Laps
from drcli.records.stage import is_untaught


@dataclass(frozen=True)
class ListedCheckpoint:
    """A checkpoint that is there."""

    number: Annotated[int, "What --checkpoint takes.", Col("checkpoint")]
    name: Annotated[str, "Such as `12_Step-7824.ckpt`."]
    words: Annotated[
        list[CheckpointWord],
        "The words that also choose it: last, best, first-lap, three-laps, best-lap.",
        Col("is", of=lambda each: each.meaning(), side="left"),
    ]
    every: Annotated[bool, "Whether it is kept because of DR_TRAIN_KEEP_EVERY."]
    episodes: Annotated[int, "Episodes of its evaluation; 0 without one."]
    laps: Annotated[
        int,
        "Clean laps among them: an episode ends at the first violation.",
        Col(
            "clean laps",
            of=lambda each: f"{each.laps} of {each.episodes}" if each.episodes else None,
        ),
    ]
    progress: Annotated[
        float | None,
        "Their mean, percent of a lap; None without an evaluation.",
        Col("progress", "{:.1f} %"),
    ]
    best_lap_s: Annotated[
        float | None,
        "Fastest clean lap, simulated seconds; None without one.",
        Col("best lap", "{:.2f} s"),
    ]
    size_bytes: Annotated[int, "All its files.", Col("size", size_text)]
    problem: Annotated[str, "What is wrong with it; empty if nothing is known."] = ""
    form: Annotated[
        Literal["drcli", "tensorflow"],
        "`tensorflow` for a checkpoint of DeepRacer-for-Cloud or a console, else `drcli`.",
    ] = "drcli"
    median_s: Annotated[
        float | None, "Median time of the clean laps; None if unknown.", Col("median", "{:.2f} s")
    ] = None
    untaught: Annotated[
        bool, "Whether its camera policy has not learned yet, because a teacher comes first."
    ] = False

    def meaning(self) -> str:
        also = {"every n-th": self.every, "TensorFlow": self.form == "tensorflow"}
        also["untaught"] = self.untaught
        return ", ".join([*self.words, *(word for word, true in also.items() if true)]) or "-"


@dataclass(frozen=True)
class MilestoneEntry(MilestoneReport):
    """A milestone in the list."""

    kept: Annotated[bool, "Whether the checkpoint is still there."]

    def __str__(self) -> str:
        laps = f"{self.laps} of {counted(self.episodes, 'lap')} clean, best {self.best_lap_s:.2f} s"
        gone = "" if self.kept else " (deleted)"
        return f"{self.word}: checkpoint {self.checkpoint.partition('_')[0]}, {laps}{gone}"


@dataclass(frozen=True)
class CheckpointList:
    """The checkpoints of a model."""

    model: Annotated[str, "As s3://bucket/prefix."]
    checkpoints: Annotated[list[ListedCheckpoint], "All that are there, oldest first."]
    milestones: Annotated[
        list[MilestoneEntry], "Those that were reached, also by a deleted checkpoint."
    ]
    not_reached: Annotated[list[MilestoneKind], "The words of the others."]
    size_bytes: Annotated[int, "Of all checkpoints."]
    damaged: Annotated[
        list[str],
        "What is wrong with each damaged object that the list needs, and what to do about "
        "it; it is reconstructed as far as possible.",
    ] = field(default_factory=list)

    def view(self) -> View:
        order = ("number", "words", "laps", "progress", "median_s", "best_lap_s", "size_bytes")
        untaught = "untaught: until there only the teacher has learned (`dr docs teacher`)."
        count = counted(len(self.checkpoints), "checkpoint")
        return [
            bold(self.model),
            table(self.checkpoints, *order),
            f"{count}, {size_text(self.size_bytes)}.",
            any(each.untaught for each in self.checkpoints) and untaught,
            *(str(each) for each in self.milestones if not each.kept),
            self.not_reached and f"Not reached: {', '.join(self.not_reached)}.",
            *(
                Styled(f"Checkpoint {each.number}: {each.problem}", "bold yellow")
                for each in self.checkpoints
                if each.problem
            ),
        ]


def list_checkpoints(model: ModelStore, *, check: bool = False) -> CheckpointList:
    """List the checkpoints of a model; with `check`, their files are compared.

    Raises:
        SettingsError: There is no such model.
    """
    if not keys.is_valid_prefix(model.prefix):
        raise SettingsError(
            f"{model.prefix!r} is not the prefix of a model.",
            remedy="List the models with `dr-list-models`.",
        )
    checkpoints = ModelCheckpoints.read(model)
    if not checkpoints.names:
        raise SettingsError(f"{checkpoints.model.url} has no checkpoint.", remedy=what_helps(model))
    history = checkpoints.history
    results = readable_evaluations(model).values()
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
    marked = {found.name: found for _, found in checkpoints.milestones.reached()}
    sizes = _sizes(checkpoints)
    store = CheckpointStore(model)
    spaced = set(checkpoints.milestones.spaced)
    there = {info.key for info in checkpoints.listed}
    listed = []
    for name in checkpoints.names:
        progress, lap_s = evaluated.get(name.number, ([], []))
        known = marked.get(name)
        if known is None or progress:
            seen = len(progress), len(lap_s), _mean(progress), min(lap_s, default=None)
        else:
            seen = known.episodes, known.laps, known.progress, known.best_lap_s
        untaught = is_untaught(history, name.number)
        words = checkpoints.words_for(name)
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
                problem=_problem(checkpoints, store, name, check=check),
                form="tensorflow" if is_tensorflow(there, model.prefix, str(name)) else "drcli",
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
            found.name in checkpoints.names,
        )
        for kind, found in checkpoints.milestones.reached()
    ]
    words_known = {entry.word for entry in reached}
    records = [
        str(n) for n in checkpoints.names if keys.checkpoint_record(model.prefix, str(n)) in there
    ]
    return CheckpointList(
        checkpoints.model.url,
        listed,
        reached,
        [kind for kind in KINDS if kind not in words_known],
        sum(sizes.values()),
        [*checkpoints.damaged, *filter(None, at_once(partial(_damage, store), records))],
    )


def _damage(store: CheckpointStore, name: str) -> str:
    try:
        store.record(name)
    except ObjectDamaged as error:
        return f"{error} {error.remedy}"
    except (ObjectMissing, ObjectNewer):
        pass
    return ""


def _mean(progress: list[float]) -> float | None:
    return sum(progress) / len(progress) if progress else None


def _sizes(checkpoints: ModelCheckpoints) -> dict[CheckpointName, int]:
    sizes = dict.fromkeys(checkpoints.names, 0)
    graphs = {
        keys.checkpoint_graph(checkpoints.model.prefix, name.number): name
        for name in checkpoints.names
    }
    for info in checkpoints.listed:
        name = keys.checkpoint_of(checkpoints.model.prefix, info.key) or graphs.get(info.key)
        if name is not None:
            sizes[name] += info.size_bytes
    return sizes


def _problem(
    checkpoints: ModelCheckpoints, store: CheckpointStore, name: CheckpointName, *, check: bool
) -> str:
    missing = checkpoints.missing_parts(str(name))
    if missing:
        return f"{missing[0].rpartition('/')[2]} is missing."
    tensors = keys.checkpoint_tensors(checkpoints.model.prefix, str(name))
    if not check or not any(info.key == tensors for info in checkpoints.listed):
        return ""
    try:
        store.load(str(name))
    except (ObjectMissing, ObjectDamaged) as error:
        return str(error)
    return ""


# Reads a checkpoint with all files that belong to it.


METADATA = "model/" + keys.MODEL_METADATA_FILE
HYPERPARAMETERS = "ip/" + keys.HYPERPARAMETERS_FILE
METRICS = "metrics/"
TRAINING_START = "ip/run.json"

SHAPING = (METADATA, HYPERPARAMETERS)
"""The weights can only be read with the network's shape in these."""

PARAMETERS_FILE = "training_params.yaml"


@dataclass(frozen=True)
class Item:
    name: str
    data: bytes


def read_checkpoint(model: ModelStore, chosen: Chosen) -> list[Item]:
    """Read a checkpoint, without an unusable optimizer state; ours are checked.

    Raises:
        ObjectMissing: A file has just been deleted.
        ObjectDamaged: A file is not what was written.
    """
    start = f"model/{chosen.name}"
    items = []
    if all(part in chosen.parts for part in OUR_PARTS):
        found = CheckpointStore(model).load(chosen.name, with_optimizer=True)
        record = found.record if found.optimizer else replace(found.record, optimizer=None)
        items.append(Item(f"{start}.safetensors", found.tensors))
        if found.optimizer is not None:
            items.append(Item(f"{start}.optimizer.safetensors", found.optimizer))
        items.append(Item(f"{start}.json", record.encode()))
    theirs = [part for part in keys.TENSORFLOW_PARTS if part in chosen.parts]
    items += [_filled(model, start + part) for part in theirs]
    graph = keys.checkpoint_graph(model.prefix, chosen.number)
    if model.bucket.exists(graph):
        items.append(_filled(model, graph.removeprefix(keys.folder(model.prefix))))
    return items


def refuse_incomplete(model: ModelConfig, store: ModelStore) -> None:
    """Raise SettingsError if shared files are missing."""
    _, missing = _shared_files(model, store)
    if missing and not store.bucket.list(keys.folder(store.prefix)):
        raise SettingsError(
            f"Meta-data files are not found. Exiting. There is no model at {store.url}.",
            remedy="Correct its name (DR_LOCAL_S3_MODEL_PREFIX, or -p); `dr-list-models` lists "
            "all models.",
        )
    if missing:
        raise SettingsError(
            f"Meta-data files are not found. Exiting. {store.url} lacks {', '.join(missing)}.",
            remedy="If it is being trained, wait for its first iteration; otherwise choose another "
            "model with -p (`dr-list-models` lists all models).",
        )


def read_model_files(
    model: ModelConfig,
    store: ModelStore,
    checkpoint: str,
    target: tuple[str, str],
    described: bytes,
) -> list[Item]:
    """Read the shared files for a copy at `target`; `described` is for a missing parameter file."""
    found, _ = _shared_files(model, store)
    items = {name: Item(name, read_complete(store.bucket, key)) for name, key in found.items()}
    for name, item in items.items():
        if not item.data and not name.startswith(METRICS):
            raise ObjectDamaged(
                f"s3://{store.bucket.name}/{found[name]} is empty.",
                remedy="Restore it from a copy, or upload another model with -p.",
            )
    own = own_files(store, checkpoint)
    for name in SHAPING:
        items[name] = Item(name, own[name.rpartition("/")[2]])
    copies = [Item(keys.MODEL_METADATA_FILE, items[METADATA].data)]
    if store.bucket.exists(keys.training_start(store.prefix)):
        copies.append(Item(TRAINING_START, store.bucket.get(keys.training_start(store.prefix))))
    for info in store.bucket.list(keys.notes_folder(store.prefix)):
        name = info.key.removeprefix(keys.folder(store.prefix))
        copies.append(Item(name, store.bucket.get(info.key)))
    parameters = _parameters(model, store, target, described)
    return [*items.values(), *copies, Item(PARAMETERS_FILE, parameters)]


def _filled(model: ModelStore, name: str) -> Item:
    data = model.bucket.get(keys.folder(model.prefix) + name)
    if not data:
        raise ObjectDamaged(
            f"{model.bucket.name}/{keys.folder(model.prefix)}{name} is empty.",
            remedy="Restore it from a copy, or choose another checkpoint.",
        )
    return Item(name, data)


def _shared_files(model: ModelConfig, store: ModelStore) -> tuple[dict[str, str], list[str]]:
    rewards = [keys.reward_function(store.prefix)]
    folders = [keys.folder(keys.metrics_prefix(store.prefix))]
    if store.prefix == model.prefix:
        rewards.append(model.reward_key)
        folders.append(keys.folder(model.metrics_prefix))
    wanted = {
        keys.REWARD_FUNCTION_FILE: rewards,
        METADATA: [keys.model_metadata(store.prefix)],
        HYPERPARAMETERS: [keys.hyperparameters(store.prefix)],
    }
    found = {}
    for name, places in wanted.items():
        key = next(filter(store.bucket.exists, places), None)
        if key is not None:
            found[name] = key
    metrics = {
        METRICS + info.key.removeprefix(folder): info.key
        for folder in dict.fromkeys(folders)
        for info in store.bucket.list(folder)
        if not keys.is_part(info.key)  # of a file that grows, which is copied as a whole
    }
    missing = [name for name in wanted if name not in found]
    return found | metrics, missing if metrics else [*missing, METRICS]


def _parameters(
    model: ModelConfig, store: ModelStore, target: tuple[str, str], described: bytes
) -> bytes:
    key = keys.parameter_file(store.prefix, model.parameters_file)
    written = store.bucket.get(key) if store.bucket.exists(key) else described
    try:
        return moved_training_parameters(written, *target)
    except ValueError as e:
        errors.warn(
            f"{store.bucket.name}/{key} is damaged: {e}. The copy is made from the settings."
        )
        return moved_training_parameters(described, *target)
