"""Machines that join a training through the bucket, with real commands and workers."""

import json
import signal
from collections.abc import Callable
from typing import Any

import psutil
import pytest

from counted_episodes import counted_episodes
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore


class Site:
    """Machines with one bucket: that of the training, and two that may join it."""

    def __init__(self, new_workspace: Callable[[], Any], bucket: Any) -> None:
        bucket.delete([info.key for info in bucket.list("")])  # of an earlier test: moto keeps them
        self.bucket = bucket
        self.home, self.away, self.other = (new_workspace() for _ in range(3))
        self.place = f"s3://{bucket.name}/{self.home.prefix}"
        address = bucket.endpoint.url
        keys_of_bucket = {"AWS_ACCESS_KEY_ID": "AKup", "AWS_SECRET_ACCESS_KEY": "secret"}
        for machine in (self.home, self.away, self.other):
            machine.environment |= keys_of_bucket
        (self.home.folder / "system.env").write_text(
            f"DR_CLOUD=remote\nDR_REMOTE_MINIO_URL={address}\nDR_LOCAL_S3_BUCKET={bucket.name}\n"
        )
        for folder in (self.away.folder, self.other.folder):
            for path in sorted(folder.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
        self.join_options = ("--join", self.place, "--endpoint-url", address)

    def history(self) -> list[dict[str, Any]]:
        content = self.bucket.get(keys.history(self.home.prefix))
        found: list[dict[str, Any]] = json.loads(content)["iterations"]
        return found

    def iterations(self) -> int:
        """How many were learned from: the number of the newest checkpoint."""
        newest = CheckpointStore(ModelStore(self.bucket, self.home.prefix)).pointed()
        return 0 if newest is None else newest.number

    def worker(self, host: "psutil.Process") -> "psutil.Process | None":
        """The simulation process of the machine that joins."""
        found = [each for each in host.children() if "joined_sim" in " ".join(each.cmdline())]
        return found[0] if found else None


@pytest.fixture
def site(new_workspace: Callable[[], Any], uploads: Any) -> Site:
    return Site(new_workspace, uploads)


def test_a_machine_that_joins_drives_what_a_worker_of_the_training_would(site, trained):
    site.home.environment["DR_WORKERS"] = "0"
    training = site.home.start("start-training", "--json")
    joined = site.home.end_of(site.away.start("start-worker", *site.join_options, "--wait"))
    ended = site.home.end_of(training)

    assert ended.returncode == 0, ended.stderr
    told = [(i["total_steps"], i["mean_reward"], i["mean_progress"]) for i in site.history()]
    alone = json.loads((trained.bucket / "model" / "metrics" / "history.json").read_text())
    assert told == [
        (i["total_steps"], i["mean_reward"], i["mean_progress"]) for i in alone["iterations"]
    ]
    assert f"Joining the training of {site.place}" in joined.stderr


@pytest.mark.nightly
def test_a_worker_that_is_killed_comes_back_and_one_that_leaves_is_not_missed(site):
    site.home.environment["DR_WORKERS"] = "1"
    site.home.hyperparameters["term_cond_max_episodes"] = 10_000
    site.home.write_custom_files()
    training = site.home.start("start-training")
    host = site.away.start("start-worker", *site.join_options, "--wait", "--json")
    machine = psutil.Process(host.pid)

    def shares() -> list[list[int]]:
        if not site.bucket.exists(keys.shares(site.home.prefix)):
            return []
        record = json.loads(site.bucket.get(keys.shares(site.home.prefix)))
        return [[s["worker"] for s in each["workers"]] for each in record["newest"]]

    site.home.wait_for(lambda: [0, 1] in shares(), "a share of the worker that has joined")
    joined = site.home.status()["joined"]
    first = site.worker(machine)
    first.kill()
    psutil.wait_procs([first], timeout=20)
    before = site.iterations()
    site.home.wait_for(lambda: site.iterations() >= before + 3, "more iterations")
    folder = f"{site.home.prefix}/1/training-simtrace/"
    site.home.wait_for(lambda: bool(site.bucket.list(folder)), "what it drives when it is back")
    host.send_signal(signal.SIGTERM)
    left = site.away.end_of(host)
    before = site.iterations()
    site.home.wait_for(lambda: site.iterations() >= before + 3, "iterations without it")
    gone = shares()[-1]
    site.home.run("stop-training")
    site.home.end_of(training)

    report = json.loads(left.stdout.splitlines()[-1])
    assert (left.returncode, report["code"], report["took_over"]) == (143, 143, False)
    assert "is started again" in left.stderr
    assert gone == [0]
    assert [(each["name"], each["alive"]) for each in joined] == [("sim-1", True)]
    assert not site.bucket.list(keys.members_folder(site.home.prefix))
    assert site.bucket.exists(keys.training_metrics("model/metrics", 1))
    copy = site.home.folder / "copy"
    for info in site.bucket.list(f"{site.home.prefix}/"):
        path = copy / info.key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(site.bucket.get(info.key))
    counts = counted_episodes(copy / site.home.prefix)
    assert len(set(counts.values())) == 1, counts


@pytest.mark.nightly
def test_of_two_machines_that_may_go_on_at_the_same_moment_one_does_and_the_other_joins_it(site):
    site.home.environment["DR_WORKERS"] = "1"
    site.home.hyperparameters["term_cond_max_episodes"] = 10_000
    site.home.write_custom_files()
    training = site.home.start(
        "start-training", "--resume-or-start", "--foreground", "--max-minutes", "60"
    )
    machines = (site.away, site.other)
    hosts = [
        each.start("start-worker", *site.join_options, "--wait", "--json") for each in machines
    ]
    members = keys.members_folder(site.home.prefix)
    site.home.wait_for(lambda: len(site.bucket.list(members)) == 2, "the other machines")
    site.home.wait_for(lambda: site.iterations() >= 2, "two iterations")
    for host in hosts:
        host.send_signal(signal.SIGSTOP)
    training.send_signal(signal.SIGTERM)
    interrupted = site.home.end_of(training)
    before = site.iterations()
    for host in hosts:
        host.send_signal(signal.SIGCONT)
    site.home.wait_for(lambda: site.iterations() >= before + 2, "iterations on another machine")
    lease = json.loads(site.bucket.get(keys.lease(site.home.prefix)))

    def has_joined() -> bool:
        records = [site.bucket.get(info.key) for info in site.bucket.list(members)]
        return lease["session"] in [json.loads(each)["session"] for each in records]

    site.home.wait_for(has_joined, "the other machine")
    for host in hosts:
        host.send_signal(signal.SIGTERM)
    ended = [each.end_of(host) for each, host in zip(machines, hosts, strict=True)]

    reports = [json.loads(each.stdout.splitlines()[-1]) for each in ended]
    assert interrupted.returncode == 75, interrupted.stderr
    assert sorted(each["took_over"] for each in reports) == [False, True]
    owner = [each["took_over"] for each in reports].index(True)
    assert lease["pid"] == hosts[owner].pid
    assert lease["term"] in (2, 3)  # both may take it, the later one keeps it
    assert "this machine goes on with it" in ended[owner].stderr
    assert "Learning in" in machines[owner].log("trainer")
    numbers = [each["iteration"] for each in site.history()]
    assert numbers == list(range(len(numbers)))


@pytest.mark.nightly
def test_a_training_that_does_not_exist_is_named(site):
    place = f"s3://{site.bucket.name}/nothing"

    refused = site.away.run("start-worker", "--join", place, *site.join_options[2:])

    assert refused.returncode == 3
    assert f"{place} is not being trained." in refused.stderr
    assert "--wait" in refused.stderr
    assert list(site.away.folder.iterdir()) == []
