"""What each kind of fault does to a machine, its network, or the bucket, and how it is undone."""

import random
import re
import resource
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import psutil

from drcli.model import keys
from drcli.records.checkpoint import CheckpointName
from fault_machine import PREFIX, Machine, Storage, send
from fault_proxy import Trap
from fault_schedule import Fault

STORAGE_FAILED, WORKER_DIED, LOST, INTERRUPTED, TERMINATED = 4, 5, 8, 75, 143

SERVER_AWAY_S = 1.0
"""How long nobody starts a killed server behind a proxy; a local one is started by its users."""


@dataclass(frozen=True)
class Effect:
    """What a fault has done.

    Attributes:
        for_s: How long it lasts; 0 for something that is done at once.
        undo: Ends it.
        codes: Exit codes that a run may have because of it. A run that ends so is continued.
        replaces: Whether the machine is gone, and another one has to continue.
        loses_checkpoint: Whether the training may have to go back to the checkpoint before.
        damaged: Keys of objects that cannot be read until they are repaired.
        skipped: Why nothing was done; empty if something was.
        until: Whether it is over before its time.
    """

    for_s: float = 0.0
    undo: Callable[[], object] = lambda: None
    codes: frozenset[int] = frozenset()
    replaces: bool = False
    loses_checkpoint: bool = False
    damaged: frozenset[str] = frozenset()
    skipped: str = ""
    until: Callable[[], bool] = lambda: False


@dataclass
class Place:
    """Where faults happen.

    Attributes:
        others: Second owners that were started, to be looked at later.
    """

    storage: Storage
    machine: Machine
    others: list[Machine] = field(default_factory=list)


def inject(fault: Fault, place: Place) -> Effect:
    """Let a fault happen."""
    return _FAULTS[fault.kind](fault, place)


def _kill(fault: Fault, place: Place) -> Effect:
    name = fault.text("process")
    if not send(place.machine.pid_of(name), signal.SIGKILL):
        return Effect(skipped=f"{name} does not run")
    if name == "server" and place.machine.cloud == "remote":
        return Effect(SERVER_AWAY_S, place.storage.ensure_running)
    return Effect(codes=frozenset({-9}) if name == "supervisor" else frozenset())


def _stop(fault: Fault, place: Place) -> Effect:
    name = fault.text("process")
    pid = place.machine.pid_of(name)
    if not send(pid, signal.SIGSTOP):
        return Effect(skipped=f"{name} does not run")
    return Effect(fault.number("for_s"), partial(send, pid, signal.SIGCONT))


CAUGHT: dict[str, str] = {
    "weights": r"/model/\d+_Step-\d+\.ckpt\.safetensors",
    "record": r"/model/\d+_Step-\d+\.ckpt\.json",
    "pointer": r"/model/\.coach_checkpoint",
    "scores": r"/model/deepracer_checkpoints\.json",
    "optimizer": r"\.optimizer\.safetensors",
    "graph": r"\.pb",
    "history": r"/metrics/history",
    "learner": r"/metrics/learner",
    "part": r"/rollouts/.*\.safetensors",
    "manifest": r"/rollouts/.*/manifest\.json",
    "trace": r"/training-simtrace/",
    "metrics": r"/TrainingMetrics",
    "evaluation": r"/evaluations/",
    "lease": r"/lease\.json",
}
"""What a key with this object in it looks like."""

CRASH_WITHIN_S = 20.0
"""How long to wait until the object is written."""


def _crash(fault: Fault, place: Place) -> Effect:
    """Kill a process, or all of the machine, just before or after it has written an object."""
    machine = place.machine
    if machine.cloud != "remote":
        return Effect(skipped="the bucket is on this machine")
    who, pattern = fault.text("who"), re.compile(CAUGHT[fault.text("on")])

    def kill() -> None:
        if who == "everybody":
            for process in machine.processes():
                send(process.pid, signal.SIGKILL)
        else:
            send(machine.pid_of(who), signal.SIGKILL)

    def forget() -> None:
        machine.proxy.trap = None

    when = "before" if fault.text("when") == "before" else "after"
    machine.proxy.trap = Trap(lambda path: pattern.search(path) is not None, when, kill)
    codes = frozenset({-9}) if who in ("everybody", "supervisor") else frozenset[int]()
    return Effect(CRASH_WITHIN_S, forget, codes, until=lambda: machine.proxy.trap is None)


def _network(**changes: object) -> Callable[[Fault, Place], Effect]:
    """A fault of the network of a machine that reaches the bucket through a proxy."""

    def begin(fault: Fault, place: Place) -> Effect:
        proxy = place.machine.proxy
        if place.machine.cloud != "remote":
            return Effect(skipped="the bucket is on this machine")
        values = {name: x(fault) if callable(x) else x for name, x in changes.items()}
        before = {name: getattr(proxy.network, name) for name in values}
        proxy.set(**values)
        return Effect(fault.number("for_s"), partial(proxy.set, **before))

    return begin


def _full(fault: Fault, place: Place) -> Effect:
    if not place.storage.has_disk:
        return Effect(skipped="the bucket has no disk of its own")
    place.storage.fill()
    codes = frozenset({STORAGE_FAILED, WORKER_DIED})
    return Effect(fault.number("for_s"), place.storage.make_room, codes)


def _quota(fault: Fault, place: Place) -> Effect:
    effect = _network(error="full", error_share=1.0)(fault, place)
    return Effect(effect.for_s, effect.undo, frozenset({STORAGE_FAILED}), skipped=effect.skipped)


def _memory(fault: Fault, place: Place) -> Effect:
    name = fault.text("process")
    pid = place.machine.pid_of(name)
    if pid is None:
        return Effect(skipped=f"{name} does not run")
    with suppress(psutil.Error, ProcessLookupError):
        limit = psutil.Process(pid).memory_info().vms + (int(fault.number("more_mb")) << 20)
        resource.prlimit(pid, resource.RLIMIT_AS, (limit, limit))
    return Effect()


def _clock(fault: Fault, place: Place) -> Effect:
    place.machine.set_clock(fault.number("ahead_s"))
    return Effect()


def _notice(_: Fault, place: Place) -> Effect:
    place.machine.metadata.announce()
    return Effect(codes=frozenset({INTERRUPTED}), replaces=True)


def _terminate(_: Fault, place: Place) -> Effect:
    if not send(place.machine.pid_of("supervisor"), signal.SIGTERM):
        return Effect(skipped="the supervisor does not run")
    # -15: the command had just begun, and no handler was installed yet.
    return Effect(codes=frozenset({TERMINATED, INTERRUPTED, -signal.SIGTERM}))


def _gone(_: Fault, place: Place) -> Effect:
    place.machine.vanish()
    return Effect(codes=frozenset({-9}), replaces=True)


def _damage(fault: Fault, place: Place) -> Effect:
    rng = random.Random(int(fault.number("seed")))
    name = fault.text("object")
    key = _key_of(name, place, rng)
    if key is None:
        return Effect(skipped=f"there is no object {name}")
    path = place.storage.path(key)
    try:
        data = path.read_bytes()
        damaged = DAMAGES[fault.text("how")](data, rng)
        if damaged is None:
            path.unlink()
        else:
            # In place, as an editor or a failing disk would; a new file would keep readers safe.
            path.write_bytes(damaged)
    except OSError:
        return Effect(skipped=f"{key} was deleted meanwhile")
    weights = name in ("weights", "record", "pointer")
    codes = {STORAGE_FAILED, WORKER_DIED} if name in RUN_ENDS_WITHOUT else set()
    return Effect(codes=frozenset(codes), loses_checkpoint=weights, damaged=frozenset({key}))


RUN_ENDS_WITHOUT = ("weights", "record", "metadata", "hyperparameters")
"""Objects that a worker needs when it starts; only `--resume` repairs or passes over them."""


def _half(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))] if data else b""


def _bit(data: bytes, rng: random.Random) -> bytes:
    if not data:
        return b"\0"
    place = rng.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << rng.randrange(8))]) + data[place + 1 :]


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes | None]] = {
    "empty": lambda data, rng: b"",
    "half": _half,
    "bit": _bit,
    "zeros": lambda data, rng: b"\0" * len(data),
    "lost": lambda data, rng: None,
}


def _key_of(name: str, place: Place, rng: random.Random) -> str | None:
    """The key of an object of the model, the newest of its kind."""
    bucket = place.storage.bucket
    fixed = {
        "pointer": keys.coach_checkpoint(PREFIX),
        "scores": keys.deepracer_checkpoints(PREFIX),
        "history": keys.history(PREFIX),
        "metrics": keys.training_metrics(keys.metrics_prefix(PREFIX), rng.randrange(2)),
        "learner": keys.learner_metrics(PREFIX),
        "lease": keys.lease(PREFIX),
        "status": keys.status(PREFIX, "trainer"),
        "metadata": keys.model_metadata(PREFIX),
        "hyperparameters": keys.hyperparameters(PREFIX),
        "note": keys.training_start(PREFIX),
    }
    if name in fixed:
        return fixed[name] if bucket.exists(fixed[name]) else None
    folders = {
        "record": (keys.model_folder(PREFIX), ".ckpt.json"),
        "weights": (keys.model_folder(PREFIX), ".ckpt.safetensors"),
        "optimizer": (keys.model_folder(PREFIX), ".ckpt.optimizer.safetensors"),
        "manifest": (keys.rollouts_folder(PREFIX), "manifest.json"),
        "part": (keys.rollouts_folder(PREFIX), ".safetensors"),
        "evaluation": (keys.evaluations_folder(PREFIX), ".json"),
    }
    folder, end = folders[name]
    found = [info for info in bucket.list(folder) if info.key.endswith(end)]
    if name in ("record", "weights"):  # the pointed one, or the one before
        names = {info.key: keys.checkpoint_of(PREFIX, info.key) for info in found}
        newest = sorted(found, key=lambda info: names[info.key] or CheckpointName(0, 0))[-2:]
        return rng.choice(newest).key if newest else None
    return max(found, key=lambda info: info.modified).key if found else None


def _second_owner(_: Fault, place: Place) -> Effect:
    """Another machine starts on the same model; it must be refused."""
    first = place.machine
    if first.record() is None:
        return Effect(skipped="there is no first owner")
    folder = first.folder.with_name(f"{first.folder.name}-second-{len(place.others)}")
    other = Machine(folder, place.storage, cloud="remote", iterations=10_000, workers=first.workers)
    other.start("--resume")
    place.others.append(other)
    return Effect()


_FAULTS: dict[str, Callable[[Fault, Place], Effect]] = {
    "kill": _kill,
    "crash": _crash,
    "stop": _stop,
    "refuse": _network(refused=True),
    "silence": _network(silent=True),
    "errors": _network(error=lambda f: f.text("code"), error_share=lambda f: f.number("share")),
    "slow": _network(latency_s=lambda f: f.number("latency_s")),
    "narrow": _network(bytes_per_s=lambda f: f.number("bytes_per_s")),
    "cut": _network(cut=lambda f: f.text("part"), cut_share=lambda f: f.number("share")),
    "old_lists": _network(old_lists=True),
    "damage": _damage,
    "fill": _full,
    "quota": _quota,
    "memory": _memory,
    "clock": _clock,
    "notice": _notice,
    "terminate": _terminate,
    "gone": _gone,
    "second_owner": _second_owner,
}
