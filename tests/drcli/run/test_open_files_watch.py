"""Workers that open more and more files."""

from dataclasses import replace

from drcli.run.heartbeat_monitor import HeartbeatMonitor
from drcli.run.memory_watch import OpenFilesWatch
from watched_run import WatchedRun


def test_a_worker_is_named_once_before_it_may_open_no_more(tmp_path):
    run = WatchedRun(tmp_path)
    heartbeats = HeartbeatMonitor(tmp_path, run.clock)
    watch = OpenFilesWatch(run.running, heartbeats, limit=lambda: 1024)

    def look(open_files: int) -> None:
        worker = run.workers["sim-0"]
        worker.heartbeat = replace(worker.heartbeat, open_files=open_files)
        run.now_s += 2.0
        run.write_pulses()
        heartbeats.look(run.children)
        watch.check()

    look(40)
    assert run.warnings == []
    look(900)
    look(950)
    assert run.told == run.warnings
    assert run.told[0].startswith("sim-0 has 900 open files and may have 1,024.")
    look(40)
    assert run.warnings == []
