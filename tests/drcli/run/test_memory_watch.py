"""Workers that grow, and workers that are killed because memory ran out."""

import signal

import pytest

from drcli.base.memory import MemoryState
from drcli.records.job import WorkerExit
from drcli.run.memory_watch import MemoryWatch
from watched_run import WatchedRun

GB = 10**9
SHORTAGE = WorkerExit("sim-0 ran out of memory: it uses 900 MB.", "Give more.", 5, memory=True)


class Stage:
    """A run whose workers have the memory that a test says."""

    def __init__(self, folder, workers=1, **settings):
        self.run = WatchedRun(folder, workers, **settings)
        self.state = MemoryState(8 * GB, 4 * GB)
        self.sizes = {child.name: 0.6 * GB for child in self.run.children}
        self.watch = MemoryWatch(
            self.run.running,
            self.run.clock,
            read=lambda: self.state,
            size_of=self.size_of,
        )

    def size_of(self, pid):
        [name] = [c.name for c in self.run.children if c.process and c.process.pid == pid]
        return int(self.sizes[name])

    def pass_time(self, minutes, **mb_per_minute):
        for _ in range(int(minutes * 12)):
            self.run.now_s += 5.0
            for name, rate in mb_per_minute.items():
                self.sizes[name.replace("_", "-")] += rate * 1e6 / 12
            assert self.watch.check() is None

    def kill(self, name, words=None):
        """The kernel kills a worker, or it ends with these words; it starts again."""
        child = self.run.child(name)
        code = -signal.SIGKILL if words is None else words.code
        child.process.returncode = code
        return self.end(name, code, words)

    def end(self, name, code, words=None):
        child = self.run.child(name)
        outcome = self.watch.died(child, code, words)
        if outcome is None and not child.excluded:
            self.run.begin(name)
        elif child.excluded:
            child.process = None
        return outcome

    def kill_for_memory(self, name):
        self.state = MemoryState(8 * GB, 4 * GB, kills=self.state.kills + 1)
        return self.kill(name)


@pytest.fixture
def stage(tmp_path):
    return Stage(tmp_path)


def test_a_leak_is_named_with_numbers_long_before_memory_is_full(stage):
    stage.pass_time(40, sim_0=10.0)

    [told] = stage.run.told
    assert told.startswith("sim-0 grows steadily: ")
    assert "the memory of the machine (8.0 GB) is full in 6 h" in told
    assert "A reward function that keeps more and more data" in told
    assert stage.run.warnings == [told]
    facts = stage.run.journal._entries[0].facts
    assert facts["worker"] == "sim-0"
    assert facts["bytes_per_minute"] == pytest.approx(10e6, rel=0.05)


def test_a_leak_that_goes_on_is_named_again_after_it_has_grown_by_half(stage):
    stage.pass_time(200, sim_0=10.0)

    assert len(stage.run.told) == 3
    assert len(stage.run.warnings) == 1


def test_a_worker_that_stays_as_it_is_is_not_named(stage):
    stage.pass_time(3, sim_0=100.0)  # as it begins
    stage.pass_time(300)

    assert stage.run.told == []


def test_growth_of_some_minutes_is_no_reason_to_foretell_half_a_day(stage):
    """As when episodes become longer, or somebody begins to watch the cars."""
    stage.state = MemoryState(24 * GB, 16 * GB)

    stage.pass_time(14, sim_0=15.0)
    stage.pass_time(60)

    assert stage.run.told == []


def test_growth_that_would_take_days_is_not_named(stage):
    stage.state = MemoryState(1000 * GB, 900 * GB)

    stage.pass_time(120, sim_0=10.0)

    assert stage.run.told == []


def test_a_worker_that_the_kernel_killed_for_memory_is_named_and_drives_fewer_cars(stage):
    stage.pass_time(1)

    assert stage.kill_for_memory("sim-0") is None

    [told] = stage.run.told
    assert told.startswith(
        "sim-0 was killed because the memory of the machine (8.0 GB) was full. It had 600 MB. "
        "trainer has 600 MB."
    )
    assert "each worker drives 1/2 of its cars at a time" in told
    assert stage.run.child("sim-0").arguments == ["0", "2"]
    assert stage.run.warnings == [told]


def test_nearly_full_memory_explains_a_kill_that_the_kernel_does_not_count(stage):
    stage.state = MemoryState(2 * GB, GB // 100, limited=True)
    stage.pass_time(0.2)
    assert stage.run.told[0].startswith(
        "Only 10 MB of the memory limit of the container or control group (2.0 GB) is left. "
        "trainer has 600 MB, sim-0 has 600 MB."
    )

    stage.kill("sim-0")

    assert "sim-0 was killed because the memory limit of the container" in stage.run.told[1]


def test_a_kill_that_is_counted_before_the_process_is_gone_explains_one_death(stage):
    stage.state = MemoryState(8 * GB, 4 * GB, kills=1)
    stage.pass_time(0.2)

    stage.kill("sim-0")
    assert len(stage.run.told) == 1
    stage.kill("sim-0")

    assert len(stage.run.told) == 1


def test_the_memory_of_a_worker_is_that_before_the_kernel_removed_it(stage):
    stage.pass_time(1)
    stage.sizes["sim-0"] = 0
    stage.pass_time(0.2)

    stage.kill_for_memory("sim-0")

    assert "It had 600 MB." in stage.run.told[0]


def test_a_kill_by_somebody_else_is_not_about_memory(stage):
    stage.pass_time(1)

    assert stage.kill("sim-0") is None

    assert stage.run.told == []
    assert stage.run.child("sim-0").arguments == ["0"]


def test_a_kill_by_another_watch_is_not_about_memory(stage):
    stage.pass_time(1)
    stage.run.child("sim-0").ended_by = "frozen"

    assert stage.kill_for_memory("sim-0") is None

    assert stage.run.told == []


def test_a_run_with_one_worker_ends_after_two_steps_and_says_what_to_do(stage):
    for divisor in ("2", "4"):
        assert stage.kill_for_memory("sim-0") is None
        assert stage.run.child("sim-0").arguments == ["0", divisor]

    outcome = stage.kill_for_memory("sim-0")

    assert outcome.code == 5
    assert "sim-0 was killed because" in outcome.message
    assert outcome.message.endswith("The training cannot get any smaller.")
    assert "DR_WORKERS" in outcome.remedy


def test_then_workers_leave_one_by_one(tmp_path):
    stage = Stage(tmp_path, workers=3)
    for _ in range(2):
        stage.kill_for_memory("sim-1")

    stage.kill_for_memory("sim-1")
    assert stage.run.child("sim-2").process.killed
    assert stage.end("sim-2", -signal.SIGKILL) is None

    assert stage.run.child("sim-2").excluded
    assert "The training goes on without sim-2" in stage.run.told[-1]
    stage.kill_for_memory("sim-1")
    assert stage.run.child("sim-1").excluded
    assert stage.kill_for_memory("sim-0").code == 5


def test_no_worker_leaves_where_each_has_its_own_track(tmp_path):
    (tmp_path / "worker-2.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    stage = Stage(tmp_path, workers=2, DR_TRAIN_MULTI_CONFIG=True)
    for _ in range(2):
        stage.kill_for_memory("sim-1")

    assert stage.kill_for_memory("sim-1").code == 5


def test_when_the_trainer_is_killed_the_simulation_gets_smaller(stage):
    stage.pass_time(1)

    stage.kill_for_memory("trainer")

    assert stage.run.child("sim-0").arguments == ["0", "2"]
    assert stage.run.child("sim-0").process.killed
    assert stage.end("sim-0", -signal.SIGKILL) is None
    assert len(stage.run.told) == 1


def test_a_leak_is_only_restarted_because_that_gives_its_memory_back(stage):
    stage.pass_time(30, sim_0=30.0)

    assert stage.kill_for_memory("sim-0") is None

    assert "It is started again." in stage.run.told[-1]
    assert "It had grown from" in stage.run.told[-1]
    assert stage.run.child("sim-0").arguments == ["0"]
    assert stage.run.warnings == []


def test_a_leak_is_restarted_before_the_kernel_chooses_a_victim(stage):
    stage.pass_time(30, sim_0=50.0)
    stage.state = MemoryState(8 * GB, GB // 100)

    stage.pass_time(0.1)

    assert stage.run.child("sim-0").process.killed
    assert "is nearly full, and sim-0 has grown from" in stage.run.told[-1]


def test_a_memory_error_makes_the_run_smaller_and_is_no_bug(stage):
    assert stage.kill("sim-0", SHORTAGE) is None
    assert stage.run.child("sim-0").arguments == ["0", "2"]
    stage.kill("sim-0", SHORTAGE)

    outcome = stage.kill("sim-0", SHORTAGE)

    assert outcome.message.startswith("sim-0 ran out of memory: it uses 900 MB.")
    assert "bug" not in outcome.message + outcome.remedy


def test_deaths_for_memory_are_not_counted_as_quick_deaths(stage):
    stage.run.child("sim-0").quick_deaths = 3

    stage.kill_for_memory("sim-0")

    assert stage.run.child("sim-0").quick_deaths == 0
