"""What a start of a training notes: its machine, versions, and what has changed."""

import socket
import time
from collections.abc import Mapping, Sequence
from typing import Any

from drcli.exchange.journal_entry import JournalEntry
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.training_start import TrainingStart


def start_entries(
    start: TrainingStart, resumes: str | None, previous: RunOutcome | None, repairs: Sequence[str]
) -> tuple[JournalEntry, ...]:
    now = time.time()
    host = socket.gethostname()
    begins = f"resumes from {resumes}" if resumes else "begins a new model"
    machine, versions = start.machine, start.versions
    where = f"{host} ({machine.get('cores')} cores, {machine.get('processor')})"
    text = f"A start on {where} with drcli {versions.get('drcli')} {begins}."
    before = start.earlier[-1] if start.earlier else None
    facts: dict[str, Any] = {"host": host, "machine": machine, "versions": versions}
    facts["resumes"] = resumes
    if before is not None:
        changed = differences(before.settings or {}, start.settings or {})
        updated = differences(before.versions, versions)
        facts |= {"settings_changed": changed, "versions_changed": updated}
        if changed:
            text += f" Changed settings: {_listed(changed)}."
        if updated:
            text += f" Changed versions: {_listed(updated)}."
    entries = [JournalEntry(now, "start", text, facts)]
    if previous is not None and not previous.ended and previous.host:
        gone = f"The start on {previous.host} ended without recording why; this one took over."
        entries.append(JournalEntry(now, "recovery", gone, {"session": previous.session}))
    entries += [JournalEntry(now, "recovery", sentence, {}) for sentence in repairs]
    return tuple(entries)


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[Any]]:
    names = sorted({*before, *now})
    return {
        name: [before.get(name), now.get(name)]
        for name in names
        if before.get(name) != now.get(name)
    }


def _listed(changed: Mapping[str, list[Any]]) -> str:
    return ", ".join(
        f"{name} {_shown(before)} -> {_shown(now)}" for name, (before, now) in changed.items()
    )


def _shown(value: Any) -> str:
    return "(not set)" if value is None else str(value)
