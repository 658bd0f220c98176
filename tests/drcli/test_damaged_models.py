"""Whatever small object of a model is damaged: it is named, and commands go on without it."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save

from drcli.base.errors import DrError
from drcli.base.json_record import Fingerprint
from drcli.bucket.bucket import Watch, remedy_of
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model import keys, lease
from drcli.model.best_checkpoint import read_scores
from drcli.model.checkpoint_list import list_checkpoints
from drcli.model.checkpoints import CheckpointStore
from drcli.model.growing_file import read_all_metrics
from drcli.model.history import read_history
from drcli.model.model_list import list_models
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.records.run_record import RunRecord, run_folder
from drcli.run.evaluation_plan import prepare_evaluation
from drcli.run.increment import plan_increment
from drcli.run.plan import RunPlan, StartOptions, prepare
from drcli.run.status import inspect
from drcli.train.sim import SimWorker
from drcli.train.trainer import Trainer
from drcli.transfer.download import DownloadOptions, download, plan_download
from drcli.transfer.upload import UploadOptions, plan_upload, upload
from drcli.workers.worker_process import StopRequested
from memory_bucket import MemoryBucket
from sampled import sampled
from training_in_memory import UntilFailure

PREFIX = "team/model"
ITERATIONS = 2
RUN_ENV = f"""DR_WORLD_NAME=reinvent_base
DR_LOCAL_S3_MODEL_PREFIX={PREFIX}
DR_UPLOAD_S3_PREFIX=team/copy
DR_TRAIN_MIN_EVAL_TRIALS=1
DR_TRAIN_MAX_ITERATIONS={ITERATIONS}
DR_TRAIN_OVERLAP=off
DR_TRAIN_SEED=7
"""


class CopiedBucket(MemoryBucket):
    """Can be copied."""

    def copied(self) -> "CopiedBucket":
        copy = CopiedBucket(self.name)
        for info in self.list(""):
            copy.put(info.key, self.get(info.key))
        return copy


class World:
    """A working folder and its buckets, which the commands find."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, here: CopiedBucket) -> None:
        self.folder = folder
        self.here = here
        self.there = CopiedBucket("uploads")
        places = (
            *("run.plan", "run.increment", "run.evaluation_plan", "workers.worker_process"),
            *("transfer.upload", "transfer.download", "transfer.transfer_buckets"),
        )
        for module in places:
            patch.setattr(f"drcli.{module}.open_bucket", lambda *_, **__: self.here)
        patch.setattr("drcli.run.status.open_running_bucket", lambda *_: self.here)
        patch.setattr("drcli.transfer.transfer_buckets.open_running_bucket", lambda *_: self.here)
        patch.setattr(
            "drcli.transfer.transfer_buckets.open_upload_bucket", lambda *_, **__: self.there
        )
        patch.setattr("drcli.checks.before_start.try_inputs", lambda *_: [])
        patch.setattr(
            "drcli.model.run_metadata._git", lambda *_: None
        )  # six processes for each start

    @property
    def settings(self) -> Settings:
        return load_settings(self.folder)

    def planned(self, **options: Any) -> RunPlan:
        """A training that could start; its prefix is free again."""
        plan = prepare(self.settings, StartOptions(**options))
        lease.release(ModelStore(self.here, PREFIX), plan.job.session)
        return plan


def write_folder(folder: Path) -> None:
    custom = folder / "custom_files"
    custom.mkdir()
    (folder / "system.env").write_text("DR_CLOUD=local\nDR_UPLOAD_S3_BUCKET=uploads\n")
    (folder / "run.env").write_text(RUN_ENV)
    (custom / "reward_function.py").write_text("def reward_function(p):\n    return 1.0\n")
    parameters = {"batch_size": 32, "num_epochs": 1, "num_episodes_between_training": 2}
    (custom / "hyperparameters.json").write_text(json.dumps(parameters))
    actions = [{"steering_angle": s, "speed": 4.0} for s in (-30.0, 30.0)]
    metadata = {
        "action_space": actions,
        "action_space_type": "discrete",
        "sensor": ["FRONT_FACING_CAMERA"],
        "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
        "training_algorithm": "clipped_ppo",
        "version": "5",
    }
    (custom / "model_metadata.json").write_text(json.dumps(metadata))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> CopiedBucket:
    """A model as the real workers leave it, after two iterations."""
    folder = tmp_path_factory.mktemp("trained")
    write_folder(folder)
    with pytest.MonkeyPatch.context() as patch:
        world = World(folder, patch, CopiedBucket("bucket"))
        job = world.planned().job
        stop_signal: Any = UntilFailure()

        def learn() -> None:
            try:
                Trainer(job, stop_signal).run()
            except BaseException as error:
                stop_signal.failures.append(error)

        learner = threading.Thread(target=learn, daemon=True)
        learner.start()
        with suppress(StopRequested):
            SimWorker(job, stop_signal, 0).run()
        learner.join(60)
        assert stop_signal.failures == []
    shrink(world.here)
    return world.here


def shrink(bucket: MemoryBucket) -> None:
    """Give the checkpoints small weights, which are quick to compare."""
    for name in map(str, ModelListing(ModelStore(bucket, PREFIX)).whole):
        record = CheckpointStore(ModelStore(bucket, PREFIX)).record(name)
        small = save({"weights": np.zeros(record.number + 1, np.float32)})
        bucket.put(keys.checkpoint_tensors(PREFIX, name), small)
        optimizer = None
        if record.optimizer is not None:
            optimizer = Fingerprint.of(small)
            bucket.put(keys.checkpoint_optimizer(PREFIX, name), small)
        record = replace(record, tensors=Fingerprint.of(small), optimizer=optimizer)
        bucket.put(keys.checkpoint_record(PREFIX, name), record.encode())


@pytest.fixture
def world(working_folder: Path, trained: CopiedBucket, monkeypatch: pytest.MonkeyPatch) -> World:
    """The same model, to be damaged, after its training has ended."""
    for name in ("run.env", "system.env"):
        (working_folder / name).unlink()
    write_folder(working_folder)
    world = World(working_folder, monkeypatch, trained.copied())
    monkeypatch.setattr("drcli.model.lease.is_owner_alive", lambda held: False)
    settings = world.settings
    RunRecord(
        run_id=0,
        session="abc",
        bucket="bucket",
        prefix=PREFIX,
        world="reinvent_base",
        state="finished",
        pid=2**22,
        pid_started=1.0,
        started_at=time.time(),
        ended_at=time.time(),
        exit_code=0,
    ).write(run_folder(working_folder, settings.run_id))
    return world


def test_every_checkpoint_has_its_graph_beside_it(trained):
    numbers = {name.number for name in ModelListing(ModelStore(trained, PREFIX)).whole}

    graphs = {info.key for info in trained.list(f"{PREFIX}/model/") if info.key.endswith(".pb")}

    assert graphs == {keys.checkpoint_graph(PREFIX, number) for number in numbers}


OBJECTS = {
    "pointer": keys.coach_checkpoint(PREFIX),
    "index": keys.deepracer_checkpoints(PREFIX),
    "history": keys.history(PREFIX),
    "metrics": keys.training_metrics(keys.metrics_prefix(PREFIX)),
    "record": "record",
    "note": keys.training_start(PREFIX),
    "hyperparameters": keys.hyperparameters(PREFIX),
    "metadata": keys.model_metadata(PREFIX),
    "evaluation": keys.evaluation_result(PREFIX, 0),
    "lease": keys.lease(PREFIX),
    "trainer": keys.status(PREFIX, "trainer"),
    "finished": keys.finished(PREFIX),
    "parameters": keys.parameter_file(PREFIX, "training_params.yaml"),
}

DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut short": lambda data: data[: len(data) // 2],
    "cut by one byte": lambda data: data[:-1],
    "zeros": lambda data: b"\0" * len(data),
    "a bit of its first byte": lambda data: bytes([data[0] ^ 0x80]) + data[1:],
    "a bit in its middle": lambda data: (
        data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 0x80]) + data[len(data) // 2 + 1 :]
    ),
    "a list": lambda data: b"[1, 2]",
    "a number": lambda data: b"7",
    "null": lambda data: b"null",
    "no keys": lambda data: b"{}",
    "other types": lambda data: _with_leaves(data, "x"),
    "numbers": lambda data: _with_leaves(data, 1e300),
    "NaN": lambda data: _with_leaves(data, float("nan")),
    "lists": lambda data: _with_leaves(data, [[]]),
    "brackets": lambda data: b"[" * 3_000,
    "digits": lambda data: b"9" * 10_000,
}


def _with_leaves(data: bytes, leaf: object) -> bytes:
    """The same object with another value in all its places."""

    def replaced(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: replaced(item) for key, item in value.items()}
        if isinstance(value, list) and value:
            return [replaced(item) for item in value]
        return leaf

    try:
        return json.dumps(replaced(json.loads(data))).encode()
    except ValueError:  # plain text
        return json.dumps(leaf).encode()


def key_of(world: World, name: str) -> str:
    if name != "record":
        return OBJECTS[name]
    newest = CheckpointStore(ModelStore(world.here, PREFIX)).pointed()
    return keys.checkpoint_record(PREFIX, str(newest))


def damaged(world: World, name: str, damage: str) -> str:
    """Damage an object; the key of it."""
    key = key_of(world, name)
    world.here.put(key, DAMAGES[damage](world.here.get(key)))
    return key


@pytest.mark.parametrize(("name", "damage"), sampled(OBJECTS, DAMAGES))
def test_a_training_goes_on_from_a_model_with_a_damaged_object(world, name, damage, told):
    key = damaged(world, name, damage)

    plan = world.planned(resume=True)

    assert plan.resumes == str(CheckpointStore(ModelStore(world.here, PREFIX)).pointed())
    assert plan.job.seed == 7
    assert_whole(world.here)
    if is_told(name, damage):
        assert [sentence for sentence in told if key in sentence]
        [kept] = [info.key for info in world.here.list(f"runs/{PREFIX}/damaged/")]
        assert not kept.endswith((".json", ".py", ".coach_checkpoint"))


@pytest.mark.parametrize(
    "name", ["pointer", "index", "history", "metrics", "hyperparameters", "metadata"]
)
def test_a_training_goes_on_from_a_model_that_has_lost_an_object(world, name, told):
    key = key_of(world, name)
    newest = str(CheckpointStore(ModelStore(world.here, PREFIX)).pointed())
    world.here.delete([key])

    plan = world.planned(resume=True)

    assert plan.resumes == newest
    assert_whole(world.here)
    assert [sentence for sentence in told if key in sentence and "missing" in sentence]
    assert [info.key for info in world.here.list(f"runs/{PREFIX}/damaged/")] == []


def test_what_a_model_has_lost_for_good_is_not_told_at_every_start(world, told):
    world.here.delete([key_of(world, "history")])
    world.here.delete(info.key for info in world.here.list(PREFIX + "/") if "simtrace" in info.key)
    world.planned(resume=True)
    told.clear()

    world.planned(resume=True)

    assert told == []


def is_told(name: str, damage: str) -> bool:
    """Whether the repair of a model needs the object, so that its damage is told."""
    if name in ("lease", "trainer"):
        return damage in ("empty", "cut short", "a list")
    if (name, damage) == ("hyperparameters", "no keys"):
        return False  # that is a file with nothing but defaults
    return name not in ("finished", "parameters")


def assert_whole(bucket: MemoryBucket) -> None:
    """All small objects say what they said before."""
    assert [r.iteration for r in read_history(ModelStore(bucket, PREFIX))] == list(
        range(ITERATIONS)
    )
    scores = read_scores(ModelStore(bucket, PREFIX))
    assert scores is not None
    assert scores.last_checkpoint.name.startswith(f"{ITERATIONS}_Step-")
    records = read_all_metrics(bucket, keys.training_metrics(keys.metrics_prefix(PREFIX)))
    driven = [r.episode for r in records if r.phase == "training"]
    assert driven == list(range(1, 2 * ITERATIONS + 1))
    for name in ModelListing(ModelStore(bucket, PREFIX)).whole:
        CheckpointStore(ModelStore(bucket, PREFIX)).load(str(name))


@contextmanager
def no_bar(what: str, total: int) -> Iterator[Watch]:
    yield lambda more: None


def status(world: World) -> list[str]:
    report = inspect(world.settings.run)
    assert len(report.history) == ITERATIONS
    assert report.last is not None
    return report.damaged


def evaluate(world: World) -> list[str]:
    plan = prepare_evaluation(world.settings)
    assert len(plan.checkpoints) == 1
    return []


def upload_model(world: World) -> list[str]:
    planned = plan_upload(world.settings, UploadOptions("last"))
    upload(planned, world.settings, no_bar)
    copy = CheckpointStore(ModelStore(world.there, "team/copy"))
    assert copy.load_latest() is not None
    return []


def download_model(world: World) -> list[str]:
    world.there, world.here = world.here, CopiedBucket("bucket")
    options = DownloadOptions(f"s3://uploads/{PREFIX}", "mine")
    planned = plan_download(world.settings, options)
    download(planned, world.settings, no_bar)
    assert CheckpointStore(ModelStore(world.here, "mine")).load_latest() is not None
    assert [r.iteration for r in read_history(ModelStore(world.here, "mine"))] == list(
        range(ITERATIONS)
    )
    return []


def list_all(world: World) -> list[str]:
    (model,) = list_models(world.here).models
    assert model.last is not None
    return model.damaged


def increment(world: World) -> list[str]:
    planned = plan_increment(world.settings, prefix="team/other")
    assert planned.step.pretrained.sha256
    return []


READERS = {
    "status": (status, {"index", "history"}),
    "evaluate": (evaluate, set(OBJECTS) - {"finished", "parameters"}),
    "upload": (upload_model, set(OBJECTS) - {"finished", "parameters"}),
    "download": (download_model, {"index", "pointer"}),
    "list": (list_all, {"index"}),
    "increment": (increment, set(OBJECTS) - {"finished", "parameters"}),
}


@pytest.mark.parametrize(("name", "reader"), sampled(OBJECTS, READERS))
def test_a_command_says_what_is_damaged_and_goes_on(world, name, reader, told):
    read, tells = READERS[reader]
    whole = world.here
    for damage in DAMAGES:
        world.here = whole.copied()
        world.there = CopiedBucket("uploads")
        told.clear()
        key = damaged(world, name, damage)

        try:
            said = read(world) + told
        except DrError as error:
            pytest.fail(f"{damage}: {error} {error.remedy}")

        if name in tells and is_told(name, damage):
            end = key.removeprefix(f"{PREFIX}/")
            assert any(end in sentence for sentence in said), (damage, said)


def list_of_checkpoints(world: World) -> list[str]:
    return list_checkpoints(ModelStore.of(world.settings.model, world.here, PREFIX)).damaged


LISTS: dict[str, tuple[Callable[[World], list[str]], tuple[str, ...]]] = {
    "status": (status, ("index", "history")),
    "list-models": (list_all, ("index",)),
    "list-checkpoints": (list_of_checkpoints, ("index", "history", "record")),
}
"""With the objects that each needs; others are nothing to it."""


@pytest.mark.parametrize("listing", LISTS)
@pytest.mark.parametrize("name", ["pointer", "index", "history", "record", "lease", "outcome"])
def test_a_list_says_what_to_do_about_a_damaged_object_that_it_needs(world, name, listing):
    key = keys.outcome(PREFIX) if name == "outcome" else key_of(world, name)
    world.here.put(key, b"")
    read, needs = LISTS[listing]

    said = read(world)

    if name not in needs:
        assert said == []
        return
    [text] = said

    assert text.startswith(f"bucket/{key} is damaged: ")
    assert text.endswith(f". {remedy_of(key)}")


def test_a_whole_model_has_nothing_to_tell(world):
    assert [text for read, _ in LISTS.values() for text in read(world)] == []
