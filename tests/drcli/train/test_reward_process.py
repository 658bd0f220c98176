"""The process of the reward functions: what it answers, reaches, and leaves behind (issue 35)."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path

import psutil
import pytest

from drcli.base.confinement import offered
from drcli.drive import reward_access
from drcli.drive.reward_client import RewardProcess
from drcli.rewards.source import stuck_place
from drsim.errors import RewardError

pytestmark = pytest.mark.nightly

linux = pytest.mark.skipif(sys.platform != "linux", reason="Linux only")

WAYPOINTS = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]

LOOK = """
import json, os, socket, subprocess
def tried(what):
    try:
        return repr(what())
    except OSError as error:
        return type(error).__name__
def reward_function(params):
    print(json.dumps({name: tried(what) for name, what in WHAT.items()}), flush=True)
    return 1.0
"""

DIVIDES = """
import os, pathlib, signal, time
def reward_function(params):
    if not os.fork():
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if not os.fork():
            pathlib.Path("orphan.txt").write_text(str(os.getpid()))
            time.sleep(600)
        os._exit(0)
    os.wait()
    while not os.path.exists("orphan.txt") or not os.stat("orphan.txt").st_size:
        time.sleep(0.01)
    AFTER
    return 1.0
"""

WORKER = """
import sys
from pathlib import Path
from drcli.drive import reward_client
process = reward_client.RewardProcess(Path(sys.argv[1]), 1)
call = {"is_reversed": False, "waypoints": [(0.0, 0.0)]}
process.rewards([0], [call], 30.0, lambda *_: 0.0)
print("called", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with secrets, which is the current one, and the home in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in (
        *("system.env", "run.env", "worker-1.env", ".netrc", "home/.aws/credentials"),
        *("home/.ssh/id_ed25519", "data/s3/.server.json", "data/viewer/token.json"),
        *("elsewhere/.server.json", "elsewhere/bucket/weights"),
        *("experiments/fast/system.env", "custom_files/line.txt"),
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    (tmp_path / "key").symlink_to("home/.ssh")
    return tmp_path


@pytest.fixture
def begin(folder: Path) -> Iterator[Callable[..., RewardProcess]]:
    """Begin a process for a file of that text."""
    begun: list[RewardProcess] = []

    def start(text: str, cars: int = 1) -> RewardProcess:
        begun.append(RewardProcess(own_file(folder, text), cars))
        return begun[-1]

    yield start
    for process in begun:
        process.close()


def own_file(folder: Path, text: str) -> Path:
    file = folder / "data" / "runs" / "0" / "sim-0" / "reward_function.py"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def refuse(_call: int, error: RewardError) -> float:
    raise error


def call(process: RewardProcess, cars: list[int], on_error=refuse, **params: object) -> list[float]:
    calls = [{"is_reversed": False, "waypoints": [*WAYPOINTS], **params} for _ in cars]
    return process.rewards(cars, calls, 5.0, on_error).rewards


def seen(begin, capsys, **what: str) -> dict[str, str]:
    """What each of these expressions gives in a reward function, or how it fails."""
    named = ", ".join(f"{name!r}: lambda: {each}" for name, each in what.items())
    process = begin(f"{LOOK}WHAT = {{{named}}}\n")
    call(process, [0])
    process.close()
    return json.loads(capsys.readouterr().out)


def needs(freedom: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(freedom not in offered(), reason=f"the kernel limits no {freedom}")


def test_each_car_has_its_own_variables_and_all_have_the_waypoints(begin):
    process = begin(
        "count = 0\ndef reward_function(params):\n    global count\n    count += 1\n"
        "    params['waypoints'].append(0)\n    at = list(params).index('waypoints')\n"
        "    return count + 10.0 * len(params['waypoints']) + 100.0 * at\n",
        3,
    )

    assert call(process, [0, 2], z=1) == [141.0, 141.0]
    assert call(process, [0, 1, 2], z=1) == [142.0, 141.0, 142.0]


def test_failures_are_those_of_a_call_in_the_same_process(begin):
    process = begin("def reward_function(params):\n    return 1.0 / params['x']\n")
    found: list[tuple[int, RewardError]] = []

    def note(number: int, error: RewardError) -> float:
        found.append((number, error))
        return -1.0

    calls = [{"is_reversed": False, "waypoints": [*WAYPOINTS], "x": x} for x in (2.0, 0.0, 4.0)]
    rewards = process.rewards([0, 0, 0], calls, 5.0, note).rewards

    assert rewards == [0.5, -1.0, 0.25]
    [(number, error)] = found
    assert (number, error.kind, error.line, error.params) == (1, "raises", 2, {"x": 0.0})
    assert error.source == "return 1.0 / params['x']"
    assert type(error.__cause__).__name__ == "ZeroDivisionError"


@pytest.mark.parametrize(
    ("text", "kind", "line"),
    [
        ("def reward_function(params):\n    return 1 +\n", "load", 2),
        ("import no_such_package\n", "load", 1),
        ("def reward(params):\n    return 1.0\n", "signature", None),
    ],
)
def test_a_file_that_cannot_be_loaded_is_refused_as_ever(begin, text, kind, line):
    with pytest.raises(RewardError) as refusal:
        begin(text)

    assert (refusal.value.kind, refusal.value.line) == (kind, line)


def test_an_endless_loop_ends_the_calls_with_its_line(begin):
    process = begin("def reward_function(params):\n    while True:\n        pass\n")
    calls = [{"is_reversed": False, "waypoints": [*WAYPOINTS]}]

    with pytest.raises(RewardError, match=r"did not return within 0\.2 s") as refusal:
        process.rewards([0], calls, 0.2, lambda *_: 0.0)

    assert refusal.value.line in (2, 3)


def test_a_loop_that_swallows_what_would_end_it_ends_the_calls_with_its_line(begin):
    process = begin(
        "def reward_function(params):\n    while True:\n        try:\n            while True:\n"
        "                pass\n        except:\n            pass\n"
    )
    calls = [{"is_reversed": False, "waypoints": [*WAYPOINTS]}]

    with pytest.raises(RewardError, match="swallows what is raised to end it") as refusal:
        process.rewards([0], calls, 0.1, lambda *_: 0.0)

    assert refusal.value.line in range(2, 8)


@linux
def test_a_worker_whose_function_waits_where_nothing_can_interrupt_it_says_where(folder):
    file = own_file(
        folder,
        "import ctypes\ndef reward_function(params):\n    libc = ctypes.CDLL(None)\n"
        "    mutex = ctypes.create_string_buffer(64)\n    libc.pthread_mutex_lock(mutex)\n"
        "    libc.pthread_mutex_lock(mutex)\n    return 1.0\n",
    )
    impatient = WORKER.replace("process =", "reward_client._PATIENCE_S = 0.1\nprocess =")

    done = subprocess.run(
        [sys.executable, "-c", impatient.replace("30.0", "0.1"), str(file)],
        capture_output=True,
        timeout=60,
    )

    assert done.returncode == -signal.SIGPROF
    assert stuck_place(done.stdout.decode()) == (file, 6)


PRINTS = """
import subprocess, sys, threading, warnings
def reward_function(params):
    print("mine", end="")
    subprocess.run(["echo", " of-a-program"], check=True)
    warnings.warn("careful")
    sys.stderr.write("to-stderr\\n")
    thread = threading.Thread(target=print, args=("of-a-thread",))
    thread.start()
    thread.join()
    return 1.0
"""


def test_what_it_prints_and_what_its_programs_print_is_printed_here(begin, capsys):
    process = begin(PRINTS)
    call(process, [0])
    process.close()

    printed = capsys.readouterr().out
    assert {"mine", "of-a-program", "to-stderr", "of-a-thread"} <= set(printed.split())
    assert "UserWarning: careful" in printed


@linux
def test_prints_that_the_disk_refuses_are_dropped_and_the_function_goes_on(begin, monkeypatch):
    process = begin("def reward_function(params):\n    print('x' * 100_000)\n    return 1.0\n")
    with suppress(OSError), Path("/dev/full").open("w") as full, monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", full)
        rewards = [call(process, [0]) for _ in range(20)]
        process.close()

    assert rewards == [[1.0]] * 20


@needs("files")
def test_it_reads_no_keys_and_no_settings(begin, capsys):
    names = {
        "settings": "system.env",
        "others": "worker-1.env",
        "hidden": ".netrc",
        "aws": "home/.aws/credentials",
        "ssh": "key/id_ed25519",
        "server": "data/s3/.server.json",
        "elsewhere": "elsewhere/.server.json",
        "bucket": "elsewhere/bucket/weights",
        "console": "data/viewer/token.json",
        "experiment": "experiments/fast/system.env",
        "shadow": "/etc/shadow",
        "boot": "/proc/1/environ",
        "parent": "/proc/{os.getppid()}/environ",
    }
    expressions = {name: f"open(f'{path}').read()" for name, path in names.items()}
    by_program = "subprocess.run(['cat', 'system.env'], stderr=-3).returncode"

    found = seen(begin, capsys, **expressions, program=by_program)

    assert found == dict.fromkeys(names, "PermissionError") | {"program": "1"}


@needs("files")
def test_it_reads_no_bucket_among_temporary_files(begin, capsys, tmp_path_factory, monkeypatch):
    shared = tmp_path_factory.mktemp("shared")
    monkeypatch.setenv("TMPDIR", str(shared))
    for name in ("notes.txt", "racer/s3/.server.json", "racer/s3/bucket/weights"):
        (shared / name).parent.mkdir(parents=True, exist_ok=True)
        (shared / name).write_text(name)
    weights, notes = shared / "racer/s3/bucket/weights", shared / "notes.txt"

    found = seen(begin, capsys, bucket=f"open('{weights}').read()", other=f"open('{notes}').read()")

    assert found == {"bucket": "PermissionError", "other": "'notes.txt'"}


def test_it_reads_its_data_and_writes_to_temporary_files_and_the_working_folder(
    begin, capsys, folder
):
    found = seen(
        begin,
        capsys,
        data="open('custom_files/line.txt').read()",
        changed="open('custom_files/line.txt', 'a').write('x')",
        made="open('log.txt', 'a').write('x')",
        temporary="__import__('tempfile').NamedTemporaryFile('w+').write('x')",
        beside="open(__file__).read(1)",
        package="__import__('numpy').__name__",
    )

    assert found == {
        **{"data": "'custom_files/line.txt'", "changed": "1", "made": "1", "temporary": "1"},
        **{"beside": "'\\n'", "package": "'numpy'"},
    }
    assert (folder / "log.txt").read_text() == "x"


@pytest.mark.parametrize("secret", ["home/.aws/credentials", "run.env", "data/s3/.server.json"])
def test_a_working_folder_or_home_inside_of_a_folder_of_programs_keeps_its_secrets(
    folder, monkeypatch, secret
):
    allowed: list[Path] = []
    monkeypatch.setattr(reward_access, "_SYSTEM", (str(folder), "/usr"))
    monkeypatch.setattr(reward_access, "confine", lambda *each: allowed.extend(chain(*each[:2])))
    monkeypatch.setattr(reward_access.confinement, "install", lambda: None)
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("TMPDIR", "/tmp")

    reward_access.confine_reward(own_file(folder, "").parent)

    assert Path("/usr") in allowed
    assert not any((folder / secret).is_relative_to(each) for each in allowed)


def test_a_temporary_folder_that_another_program_removes_meanwhile_is_no_fault(folder, monkeypatch):
    gone = folder / "temporary" / "gone"
    gone.mkdir(parents=True)
    scan = os.scandir

    def scanned(path):
        if Path(path) == gone:
            gone.rmdir()
        return scan(path)

    monkeypatch.setattr(reward_access, "confine", lambda *_: set())
    monkeypatch.setattr(reward_access.confinement, "install", lambda: None)
    monkeypatch.setattr("tempfile.tempdir", str(gone.parent))
    monkeypatch.setenv("TMPDIR", str(gone.parent))
    monkeypatch.setattr(os, "scandir", scanned)

    reward_access.confine_reward(own_file(folder, "").parent)

    assert not gone.exists()


@needs("sockets")
def test_it_opens_no_sockets(begin, capsys):
    found = seen(
        begin,
        capsys,
        tcp="socket.socket()",
        udp="socket.socket(type=socket.SOCK_DGRAM)",
        local="socket.socket(socket.AF_UNIX)",
        name="socket.getaddrinfo('localhost', 80)",
        program="subprocess.run([__import__('sys').executable, '-c', "
        "'import socket; socket.socket()'], stderr=-3).returncode",
    )

    assert found == {
        **dict.fromkeys(("tcp", "udp", "local"), "PermissionError"),
        **{"name": found["name"], "program": "1"},
    }


@needs("signals")
def test_not_even_a_program_that_it_starts_can_send_signals_to_others(begin, capsys):
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        kill = f"subprocess.run(['sh', '-c', 'kill -9 {other.pid} {os.getpid()}'], stderr=-3)"
        found = seen(begin, capsys, kill=kill, own="os.kill(os.getpid(), 0)")

        assert other.poll() is None
        other.communicate(b"\n")
    assert found["own"] == "None"


def orphan(folder: Path) -> psutil.Process:
    return psutil.Process(int((folder / "orphan.txt").read_text()))


def assert_ends(process: psutil.Process) -> None:
    """A zombie that nobody has waited for has ended, too."""
    deadline_s = time.monotonic() + 20.0
    while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline_s, "it goes on"


@linux
def test_a_grandchild_in_a_session_of_its_own_ends_with_the_process(begin, folder):
    process = begin(DIVIDES.replace("AFTER", "pass"))
    call(process, [0])
    left = orphan(folder)
    assert left.is_running()

    process.close()

    assert_ends(left)


@linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_it_ends_with_a_worker_that_is_killed(folder, number):
    file = own_file(folder, DIVIDES.replace("AFTER", "pass"))
    with subprocess.Popen(
        [sys.executable, "-c", WORKER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as worker:
        assert worker.stdout is not None
        assert worker.stdout.readline() == b"called\n"
        everything = [*psutil.Process(worker.pid).children(recursive=True), orphan(folder)]
        worker.send_signal(number)

    for each in everything:
        assert_ends(each)


@linux
@pytest.mark.parametrize(
    ("after", "code"), [("os._exit(9)", 9), ("os._exit(0)", 1), ("os.kill(os.getpid(), 11)", -11)]
)
def test_a_worker_ends_as_the_process_of_its_reward_function_does(folder, after, code):
    file = own_file(folder, DIVIDES.replace("AFTER", after))

    done = subprocess.run([sys.executable, "-c", WORKER, str(file)], capture_output=True)

    assert done.returncode == code
    assert not psutil.pid_exists(int((folder / "orphan.txt").read_text()))


@linux
@pytest.mark.parametrize("written", [r"b'\xff' * 8", r"b'\0\0\0\2ab'"])
def test_a_worker_does_not_wait_for_a_function_that_writes_into_its_connection(folder, written):
    file = own_file(
        folder,
        "import os, stat\ndef reward_function(params):\n    for each in range(3, 10):\n"
        "        try:\n            if stat.S_ISSOCK(os.fstat(each).st_mode):\n"
        f"                os.write(each, {written})\n"
        "        except OSError:\n            pass\n    return 1.0\n",
    )

    done = subprocess.run(
        [sys.executable, "-c", WORKER, str(file)], capture_output=True, timeout=60
    )

    assert done.returncode == 1
