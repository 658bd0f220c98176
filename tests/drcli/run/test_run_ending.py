"""How a run ends when its machine goes away: what is saved first, and that all is over in time."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from typing import cast

import pytest

from drcli.config.loading import load_settings
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import RunRecord, StopRequest, log_file
from drcli.records.training_record import RunOutcome
from drcli.run import supervisor
from drcli.run.command_process import CommandEnd
from drcli.run.duty import Duty, RunningTraining
from drcli.run.end_of_training import EndOfTraining
from drcli.run.interruption_watch import Renewal
from drcli.run.journal import read_journal
from drcli.run.outcome import Outcome, interrupted
from drcli.run.supervisor import Supervisor
from memory_bucket import MemoryBucket
from unwatched import Commands, job_of

STAYS = "import time; time.sleep(60)"


class SlowBucket(MemoryBucket):
    """Takes so many bytes in a second, and remembers when each object was complete."""

    def __init__(self, bytes_per_s: float = float("inf")) -> None:
        super().__init__()
        self.bytes_per_s = bytes_per_s
        self.written: list[tuple[str, float]] = []
        self._line = threading.Lock()

    def put(self, key, data, *, watch=None):
        with self._line:  # one connection to the world
            time.sleep(len(data) / self.bytes_per_s)
        super().put(key, data, watch=watch)
        self.written.append((key, time.monotonic()))

    def first(self, key):
        return next(at for name, at in self.written if name == key)


class Ends(Duty):
    """Ends the run at once, as a watch does, and saves something at its end."""

    def __init__(self, outcome: Outcome | None, names: tuple[str, ...] = (), fails: bool = False):
        super().__init__(cast("RunningTraining", None))
        self.outcome = outcome
        self.names = names
        self.fails = fails
        self.seen: list[str] = []
        self.left_s = 0.0
        self.only: tuple[str, ...] = ()

    def check(self):
        return self.outcome

    def finish(self, ending):
        self.seen.append("finish")
        self.left_s = ending.left_s()
        self.only = ending.only
        if not self.fails:
            self.names = ()

    def pending(self, ending):
        return self.names

    def after_release(self, ending):
        self.at_the_end = ending.outcome


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a supervisor whose workers stay until they are stopped."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
    (tmp_path / "system.env").write_text("DR_SIGTERM_GRACE_SECONDS=20\n")
    begun = RunOutcome("start", "here", 5.0, 6.0, goals="Ends some day.", message="It is over.")
    job = Job(
        config=load_settings(tmp_path, environ={}).run,
        session="start",
        seed=1,
        max_minutes=None,
        folder=tmp_path / "run",
        launcher_pid=os.getpid(),
        begun=begun,
    )
    job.folder.mkdir()
    started: list[str] = []

    def go(bucket, *duties, script=STAYS, during=lambda: None, **changes):
        def start_process(job, name, *_, **__):
            started.append(name)
            if isinstance(script, WorkerExit):
                script.write(job.folder, name)
                return subprocess.Popen([sys.executable, "-S", "-c", "pass"])
            process = subprocess.Popen([sys.executable, "-S", "-c", script])
            if name == "sim-0":
                during()
            return process

        monkeypatch.setattr(supervisor, "start_process", start_process)
        monkeypatch.setattr(supervisor, "POLL_S", 0.01)
        record = RunRecord(
            0, "start", "bucket", "model", "oval", "starting", os.getpid(), 0.0, time.time()
        )
        taken = lease.take(ModelStore(bucket, "model"), "start")
        code = Supervisor(
            replace(job, term=taken.term, **changes),
            bucket,
            record,
            Renewal(ModelStore(bucket, "model"), taken),
            open_bucket=lambda: bucket,
            revive_server=lambda: None,
            restart_server=lambda: None,
            duties=lambda run: [duty if isinstance(duty, Duty) else duty(run) for duty in duties],
        ).run()
        return code, RunRecord.read(job.folder), started

    go.folder = job.folder
    yield go
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_notice_with_a_slow_bucket_and_a_large_log(run, tmp_path):
    """A tenth of the time, and of what is to be saved: 5 s instead of 55, 50 MB of a log."""
    log = log_file(tmp_path, "model", "trainer")
    log.parent.mkdir(parents=True)
    log.write_bytes(b"a line of forty bytes, with its newline.\n" * (50_000_000 // 41))
    bucket = SlowBucket(5e6)
    duty = Ends(interrupted("It goes.", 5.0, continues=True))
    began_s = time.monotonic()

    code, record, _ = run(bucket, duty)

    assert code == 75
    assert time.monotonic() - began_s < 6.5
    assert record.state == "interrupted"
    assert bucket.first(keys.outcome("model")) - began_s < 1.0
    assert 1.0 < duty.left_s < 5.0
    assert any("/logs/" in key for key, _ in bucket.written)
    assert lease.live_holder(ModelStore(bucket, "model")) is None
    outcome = read_outcome(ModelStore(bucket, "model"))
    assert (outcome.state, outcome.goals, outcome.began_at) == (
        "interrupted",
        "Ends some day.",
        5.0,
    )


def test_logs_are_saved_before_the_work_of_duties_and_their_lines_after_it(run, tmp_path):
    log = log_file(tmp_path, "model", "trainer")
    log.parent.mkdir(parents=True)
    log.write_text("learned\n")
    bucket, seen = SlowBucket(), []

    class Late(Ends):
        def finish(self, ending):
            super().finish(ending)
            seen.extend(key for key, _ in bucket.written if "/logs/" in key)
            log.write_text("learned\nuploaded\n")

    run(bucket, Late(interrupted("It goes.", 5.0, continues=True)))

    [key] = [key for key in seen if key.endswith("trainer.log")]
    assert bucket.get(key) == b"learned\nuploaded\n"


def test_what_a_successor_needs_is_written_before_the_workers_have_exited(run):
    stubborn = "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(60)"
    bucket = SlowBucket()
    began_s = time.monotonic()

    run(bucket, Ends(interrupted("It goes.", 3.0, continues=False)), script=stubborn)

    assert bucket.first(keys.outcome("model")) - began_s < 0.9  # they get half of the time
    assert read_outcome(ModelStore(bucket, "model")).stays_ended


def test_the_journal_tells_how_it_ended(run):
    bucket = SlowBucket()

    run(bucket, Ends(interrupted("It goes.", 5.0, continues=True)))

    (event,) = [e for e in read_journal(ModelStore(bucket, "model")).events if e.kind == "end"]
    assert event.text.startswith("It goes. Continue with")
    assert event.facts == {"state": "interrupted", "code": 75}


def send(number):
    return lambda: os.kill(os.getpid(), number)


def test_sigterm_of_a_scheduler_interrupts_a_run_that_any_machine_may_continue(run):
    bucket = SlowBucket()

    code, record, _ = run(bucket, during=send(signal.SIGTERM), whole_run=True)

    assert (code, record.state) == (75, "interrupted")
    assert not read_outcome(ModelStore(bucket, "model")).stays_ended


def test_sigterm_of_a_plain_start_stops_it_and_the_next_start_may_go_on(run):
    bucket = SlowBucket()

    code, record, _ = run(bucket, during=send(signal.SIGTERM))

    assert (code, record.state) == (143, "stopped")
    assert not read_outcome(ModelStore(bucket, "model")).stays_ended


@pytest.mark.parametrize("whole_run", [True, False])
def test_dr_stop_training_is_no_scheduler(run, whole_run):
    def stop():
        StopRequest("start").write(run.folder)
        os.kill(os.getpid(), signal.SIGTERM)

    bucket = SlowBucket()

    code, record, _ = run(bucket, during=stop, whole_run=whole_run)

    assert (code, record.state) == (143, "stopped")
    assert read_outcome(ModelStore(bucket, "model")).stays_ended


def test_a_request_to_stop_an_earlier_start_means_nothing(run):
    StopRequest("an earlier start").write(run.folder)

    code, _, _ = run(SlowBucket(), during=send(signal.SIGTERM), whole_run=True)

    assert code == 75


def test_ctrl_c_is_a_person(run):
    bucket = SlowBucket()

    code, _, _ = run(bucket, during=send(signal.SIGINT), whole_run=True)

    assert code == 130
    assert read_outcome(ModelStore(bucket, "model")).stays_ended


DONE = WorkerExit("Training is complete.", "", 0)


def test_work_at_the_end_is_named_before_it_is_done_and_forgotten_after(run):
    bucket = SlowBucket()
    seen = []

    class Upload(Ends):
        def finish(self, ending):
            seen.append(
                (read_outcome(ModelStore(bucket, "model")).left, RunRecord.read(run.folder).ending)
            )
            super().finish(ending)

    code, record, _ = run(bucket, Upload(None, ("upload",)), script=DONE)

    assert (code, record.ending) == (0, False)
    assert seen == [(("upload",), True)]  # no worker is missed meanwhile
    outcome = read_outcome(ModelStore(bucket, "model"))
    assert (outcome.state, outcome.left, outcome.message) == ("finished", (), DONE.message)


def test_work_at_the_end_that_failed_stays_named(run):
    bucket = SlowBucket()

    run(bucket, Ends(None, ("upload",), fails=True), script=DONE)

    assert read_outcome(ModelStore(bucket, "model")).left == ("upload",)


def test_only_the_work_that_was_left_is_done_and_no_worker_starts(run):
    bucket = SlowBucket()
    duty = Ends(None, ("upload",))

    code, record, started = run(bucket, duty, end_work=("upload",))

    assert (code, started, record.workers) == (0, [], [])
    assert duty.only == ("upload",)
    outcome = read_outcome(ModelStore(bucket, "model"))
    assert (outcome.state, outcome.left, outcome.message) == ("finished", (), "It is over.")


@pytest.mark.parametrize("end_work", [("import",), ()])
def test_work_at_the_end_is_told_when_it_is_done_and_an_error_when_it_failed(
    run, tmp_path, end_work
):
    job = job_of(tmp_path, "DR_DROA_URL=https://d.example.com")

    def at_the_end_of(end):
        commands = Commands(end)
        bucket = SlowBucket()
        last = Ends(None)

        def duty(run):
            return EndOfTraining(replace(run, job=job), start=commands)

        code, record, _ = run(bucket, duty, last, end_work=end_work, script=DONE)
        assert (last.at_the_end.code, last.at_the_end.message) == (code, record.message)
        return code, record, read_outcome(ModelStore(bucket, "model"))

    code, record, outcome = at_the_end_of(CommandEnd(0, {"site": "d.example.com", "model_id": "a"}))
    assert (code, record.state, outcome.left) == (0, "finished", ())
    assert record.message.endswith("The import into DeepRacer on AWS is done: d.example.com (a).")

    # Not the code of the command, by which a scheduler takes the training for a failed one.
    code, record, outcome = at_the_end_of(CommandEnd(4, reason="It refused the model."))
    assert (code, record.exit_code, record.state) == (10, 10, "finished")
    assert record.message.endswith("The import into DeepRacer on AWS failed: It refused the model.")
    assert "--model-name team-model --best --once`, or with" in record.remedy
    # The training itself is complete: the next start tries only what is left.
    assert (outcome.state, outcome.code, outcome.left) == ("finished", 0, ("import",))


def test_the_lease_is_renewed_until_the_end(run, monkeypatch):
    monkeypatch.setattr(supervisor, "LEASE_POLL_S", 0.02)
    monkeypatch.setattr("drcli.run.interruption_watch.RENEW_S", 0.02)
    bucket = SlowBucket()
    ages = []

    class Long(Ends):
        def finish(self, ending):
            time.sleep(0.3)
            ages.append(lease.read_lease(ModelStore(bucket, "model")).age_s)

    run(bucket, Long(interrupted("It goes.", 5.0, continues=True)))

    assert ages[0] < 0.25
    assert lease.read_lease(ModelStore(bucket, "model")).released


def test_deaths_of_workers_and_what_was_done_are_in_the_journal(run):
    bucket = SlowBucket()

    class Once(Ends):
        def died(self, child, code, words):
            return interrupted("Enough.", 5.0, continues=True) if child.restarts else None

    run(bucket, Once(None), script="import sys; sys.exit(1)")

    events = read_journal(ModelStore(bucket, "model")).events
    assert {event.kind for event in events} >= {"fault", "recovery", "end"}
    fault = next(event for event in events if event.kind == "fault")
    assert "ended with exit code 1 after" in fault.text
    assert fault.facts["code"] == 1
