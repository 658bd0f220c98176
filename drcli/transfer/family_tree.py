"""Which training began with the weights of which."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from drcli.model import keys
from drcli.records.training_record import TrainingRecord
from drcli.transfer.training_details import changed_files, differences, setting_differences
from drcli.transfer.training_list import KnownTrainings, TrainingEntry, entry_of

_PLACES = ("DR_LOCAL_S3_", "DR_UPLOAD_", "DR_MODEL_DESCRIPTION", "DR_EXPERIMENT_NAME", "DR_EVAL_")
"""A child always changes these, or they do not affect training."""


@dataclass(frozen=True)
class FamilyMember:
    """A training in the tree, or a model that no training here has made."""

    model: Annotated[str, "Prefix of the model."]
    depth: Annotated[int, "How many ancestors it has here."]
    training: Annotated[TrainingEntry | None, "None for a model of which only the name is known."]
    exists: Annotated[bool, "Whether its model is still there."]
    weights: Annotated[
        str, "Its parent's checkpoint that it began with; empty for fresh weights."
    ] = ""
    changes: Annotated[
        list[str], "What differs from its parent, such as `lr 0.0003 -> 0.0001`."
    ] = field(default_factory=list)
    asked: Annotated[bool, "Whether it is the training that was asked for."] = False


@dataclass(frozen=True)
class FamilyTree:
    """Trainings with their ancestors and descendants."""

    bucket: Annotated[str, "Its name."]
    members: Annotated[
        list[FamilyMember], "Each parent before its children, which have one more in `depth`."
    ]
    damaged: Annotated[list[str], "A sentence for each record that cannot be read."] = field(
        default_factory=list
    )


def family_tree(known: KnownTrainings, of: TrainingRecord | None = None) -> FamilyTree:
    parents = {record.id: parent_of(record, known.records) for record in known.records}
    children: dict[str, list[TrainingRecord]] = {}
    strangers: dict[str, list[TrainingRecord]] = {}
    roots: list[TrainingRecord] = []
    for record in known.records:
        parent = parents[record.id]
        if parent is not None:
            children.setdefault(parent.id, []).append(record)
        elif record.parent is not None:
            strangers.setdefault(record.parent.prefix, []).append(record)
        else:
            roots.append(record)
    members: list[FamilyMember] = []
    added: set[str] = set()

    def add(record: TrainingRecord, depth: int) -> None:
        # A stack of its own: a chain of a thousand clones is deeper than Python's.
        left = [(record, depth)]
        while left:
            one, level = left.pop()
            if one.id in added:
                continue
            added.add(one.id)
            members.append(_member(known, one, parents[one.id], level, of))
            left += [(child, level + 1) for child in reversed(children.get(one.id, []))]

    if of is not None:
        top, seen = of, {of.id}
        while (above := parents[top.id]) is not None and above.id not in seen:
            top = above
            seen.add(top.id)
        strangers = {
            prefix: [top] for prefix, found in strangers.items() if top.id in {r.id for r in found}
        }
        roots = [] if strangers else [top]
    for prefix, found in sorted(strangers.items()):
        members.append(FamilyMember(prefix, 0, None, prefix in known.models))
        for record in found:
            add(record, 1)
    for record in roots:
        add(record, 0)
    if of is None:  # damaged records may name each other as parents
        for record in known.records:
            add(record, 0)
    return FamilyTree(known.bucket, members, list(known.damaged))


def parent_of(record: TrainingRecord, records: Sequence[TrainingRecord]) -> TrainingRecord | None:
    """The recorded one, else the newest of that model that began before."""
    if record.parent is None:
        return None
    of_model = [
        each for each in records if each.prefix == record.parent.prefix and each.id != record.id
    ]
    named = [each for each in of_model if each.id == record.parent_training]
    if named:
        return named[0]
    earlier = [each for each in of_model if each.began_at < record.began_at]
    return earlier[-1] if earlier and not record.parent_training else None


def changes_of(parent: TrainingRecord, child: TrainingRecord) -> list[str]:
    words = [name for name in changed_files(parent, child) if name != keys.HYPERPARAMETERS_FILE]
    found = differences(parent.hyperparameters, child.hyperparameters)
    if not parent.hyperparameters or not child.hyperparameters:
        found = []
    found += [
        each for each in setting_differences(parent, child) if not each.name.startswith(_PLACES)
    ]
    words += [f"{each.name} {_text(each.before)} -> {_text(each.after)}" for each in found]
    return words


def _member(
    known: KnownTrainings,
    record: TrainingRecord,
    parent: TrainingRecord | None,
    depth: int,
    of: TrainingRecord | None,
) -> FamilyMember:
    exists = record.id in known.existing
    return FamilyMember(
        record.prefix,
        depth,
        entry_of(record, exists=exists),
        exists,
        "" if record.parent is None else record.parent.name,
        [] if parent is None else changes_of(parent, record),
        asked=of is not None and of.id == record.id,
    )


def _text(value: object) -> str:
    return "(not set)" if value is None or value == "" else str(value)
