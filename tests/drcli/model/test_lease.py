"""Who may train on a model prefix."""

import json
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from drcli.base.errors import OwnershipLost, SettingsError
from drcli.base.processes import started_s
from drcli.model import keys, lease
from drcli.model.lease import read_lease, write_lease
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket


class Server:
    """A server with a clock of its own."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0
        self.bucket = MemoryBucket(clock=lambda: self.now_s)


@pytest.fixture
def server() -> Server:
    return Server()


@pytest.fixture
def bucket():
    return MemoryBucket()


def test_the_prefix_of_somebody_else_is_refused_and_named(bucket):
    lease.take(ModelStore(bucket, "model"), "theirs")

    with pytest.raises(SettingsError, match=f"trained by process {os.getpid()}"):
        lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


def test_the_own_prefix_is_not_refused(bucket):
    lease.take(ModelStore(bucket, "model"), "ours")

    lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


def test_a_lease_that_was_not_renewed_means_nothing(server):
    lease.take(ModelStore(server.bucket, "model"), "theirs")
    server.now_s += 61.0

    assert lease.holder(ModelStore(server.bucket, "model")) is None


def test_an_owner_that_has_ended_holds_nothing(bucket):
    taken = lease.take(ModelStore(bucket, "model"), "theirs")
    assert lease.live_holder(ModelStore(bucket, "model")) is not None

    write_lease(ModelStore(bucket, "model"), replace(taken, pid_started=1.0))

    assert lease.holder(ModelStore(bucket, "model")) is not None
    assert lease.live_holder(ModelStore(bucket, "model")) is None


def test_a_servers_clock_that_is_set_back_takes_the_prefix_from_nobody(server):
    lease.take(ModelStore(server.bucket, "model"), "theirs")

    server.now_s -= 6 * 3600.0

    assert lease.live_holder(ModelStore(server.bucket, "model")).session == "theirs"
    with pytest.raises(SettingsError, match=r"last heard from \d+ s ago"):
        lease.refuse_other_owner(ModelStore(server.bucket, "model"), "ours")


def test_the_clock_of_the_asking_machine_does_not_make_a_lease_stale(server, monkeypatch):
    lease.take(ModelStore(server.bucket, "model"), "theirs")
    server.now_s += 9.0
    monkeypatch.setattr(time, "time", lambda: server.now_s + 75.0)

    assert lease.holder(ModelStore(server.bucket, "model")).age_s == 9.0


def test_where_the_server_tells_no_time_the_clocks_of_the_machines_have_to_do(monkeypatch):
    class Timeless(MemoryBucket):
        def get_with_age(self, key):
            return self.get(key), None

    bucket = Timeless()
    lease.take(ModelStore(bucket, "model"), "theirs")
    now_s = time.time()
    monkeypatch.setattr(time, "time", lambda: now_s + 61.0)

    assert lease.holder(ModelStore(bucket, "model")) is None


def test_a_prefix_that_was_given_back_is_free_and_says_who_had_it(bucket):
    lease.take(ModelStore(bucket, "model"), "theirs")
    lease.release(ModelStore(bucket, "model"), "theirs")

    lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")

    assert lease.holder(ModelStore(bucket, "model")) is None
    assert read_lease(ModelStore(bucket, "model")).session == "theirs"


def test_nobody_gives_back_what_another_has_taken(bucket):
    lease.take(ModelStore(bucket, "model"), "theirs")
    lease.release(ModelStore(bucket, "model"), "ours")

    assert lease.holder(ModelStore(bucket, "model")).session == "theirs"


def test_a_process_of_this_machine_that_is_gone_owns_nothing(bucket):
    theirs = lease.take(ModelStore(bucket, "model"), "theirs")
    dead = subprocess.Popen([sys.executable, "-S", "-c", "pass"])
    write_lease(
        ModelStore(bucket, "model"), replace(theirs, pid=dead.pid, pid_started=started_s(dead.pid))
    )
    dead.wait()

    lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


def test_a_process_that_got_the_number_of_the_owner_is_not_the_owner(bucket):
    theirs = lease.take(ModelStore(bucket, "model"), "theirs")
    write_lease(ModelStore(bucket, "model"), replace(theirs, pid_started=1.0))

    lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


def test_a_container_with_the_same_host_name_is_another_machine(bucket):
    theirs = lease.take(ModelStore(bucket, "model"), "theirs")
    other = theirs.machine.replace("pid:[", "pid:[1")
    write_lease(ModelStore(bucket, "model"), replace(theirs, machine=other, pid=2**22 + 1))

    with pytest.raises(SettingsError, match="is being trained by process"):
        lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff", b"[]", b"null", b'{"session": "a"}', b"{}"],
)
def test_a_lease_that_cannot_be_read_is_stale(bucket, content):
    bucket.put(keys.lease("model"), content)

    lease.refuse_other_owner(ModelStore(bucket, "model"))

    assert lease.holder(ModelStore(bucket, "model")) is None


def test_a_lease_whose_time_is_not_a_number_is_stale(bucket):
    note = {"session": "a", "host": socket.gethostname(), "pid": 1, "renewed": "now"}
    bucket.put(keys.lease("model"), json.dumps(note).encode())

    assert lease.holder(ModelStore(bucket, "model")) is None


@pytest.mark.parametrize("field", ["session", "host", "pid", "term", "pid_started", "released"])
@pytest.mark.parametrize("value", [None, [], {}])
def test_a_lease_with_a_wrong_field_is_none(bucket, field, value):
    lease.take(ModelStore(bucket, "model"), "theirs")
    note = json.loads(bucket.get(keys.lease("model")))
    bucket.put(keys.lease("model"), json.dumps({**note, field: value}).encode())

    assert read_lease(ModelStore(bucket, "model")) is None


def test_a_lease_with_fields_of_a_later_version_is_valid(bucket):
    lease.take(ModelStore(bucket, "model"), "theirs")
    note = json.loads(bucket.get(keys.lease("model")))
    bucket.put(keys.lease("model"), json.dumps({**note, "room": "kitchen"}).encode())

    assert lease.holder(ModelStore(bucket, "model")).session == "theirs"


def test_a_lease_of_an_older_version_counts(bucket):
    note = {"session": "theirs", "host": "elsewhere", "pid": 1, "renewed": time.time()}
    bucket.put(keys.lease("model"), json.dumps(note).encode())

    with pytest.raises(SettingsError, match="trained by process 1 on elsewhere"):
        lease.refuse_other_owner(ModelStore(bucket, "model"), "ours")


@pytest.mark.parametrize("age_s", [0.0, 3600.0])
@pytest.mark.parametrize("released", [False, True])
def test_the_lease_of_a_newer_version_is_respected_whatever_it_says(server, age_s, released):
    bucket = server.bucket
    lease.take(ModelStore(bucket, "model"), "ours")
    theirs = {"format": 2, "owner": "theirs", "released": released}
    bucket.put(keys.lease("model"), json.dumps(theirs).encode())
    server.now_s += age_s

    for session in ("", "ours"):
        with pytest.raises(SettingsError, match="newer version of drcli") as caught:
            lease.refuse_other_owner(ModelStore(bucket, "model"), session)
        assert "Update drcli" in caught.value.remedy
    with pytest.raises(SettingsError, match="newer version of drcli"):
        lease.take(ModelStore(bucket, "model"), "ours")
    with pytest.raises(OwnershipLost, match="is trained by a newer version of drcli"):
        lease.Ownership(ModelStore(bucket, "model"), "ours", 1).check("model/a")
    lease.release(ModelStore(bucket, "model"), "ours")
    assert json.loads(bucket.get(keys.lease("model"))) == theirs


def test_a_worker_far_away_reads_the_lease_less_often(server):
    bucket, reads = server.bucket, []
    lease.take(ModelStore(bucket, "model"), "ours")
    read = bucket.get_with_age
    bucket.get_with_age = lambda key: reads.append(key) or read(key)
    near = lease.Ownership(ModelStore(bucket, "model"), "ours", clock=lambda: server.now_s)
    far = lease.Ownership(
        ModelStore(bucket, "model"),
        "ours",
        trusted_s=lease.OTHERS_TRUSTED_S,
        clock=lambda: server.now_s,
    )
    counts = {}
    for name, own in (("near", near), ("far", far)):
        reads.clear()
        for _ in range(10):
            own.check(keys.rollout_manifest("model", 3, 0))
            server.now_s += 0.2
        counts[name] = len(reads)

    assert counts == {"near": 10, "far": 2}
