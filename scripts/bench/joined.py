"""What machines that join a training bring over slow networks, and what their faults cost.

All "machines" are processes here that reach the bucket through links with a delay and a limited
rate, so that their processors are shared: compare the numbers with each other only. As root on
Linux, each is in a network namespace of its own, which has no other way to the bucket.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import psutil
from machine import facts
from namespaces import Namespace, are_possible, delete_left_over
from slow_link import SlowLink

from drcli.bucket.connect import open_bucket
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.loading import load_settings
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

ROOT = Path(__file__).resolve().parents[2]
PREFIX = "joined"
RATE_BYTES_PER_S = 50e6 / 8.0
ROUND_TRIPS_S = (0.001, 0.02, 0.1)
PROGRAMS = Path(sys.executable).parent


class Training:
    """A training without workers of its own, and the machines that join it.

    Args:
        folder: Of the training, empty.
        episodes: Of an iteration.
        workers: Of its own.
        prepare: Changes the racer's files in the folder before the training starts.
        settings: Of the environment.
    """

    def __init__(
        self,
        folder: Path,
        episodes: int,
        workers: int = 0,
        prepare: Callable[[Path], object] = lambda folder: None,
        settings: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.folder = folder
        self._links: list[SlowLink] = []
        self._namespaces: list[Namespace] = []
        self._machines: list[subprocess.Popen[bytes]] = []
        shutil.copy(ROOT / "run.env", folder)
        shutil.copy(ROOT / "system.env", folder)
        shutil.copytree(ROOT / "defaults" / "rewards" / "speed", folder / "custom_files")
        path = folder / "custom_files" / "hyperparameters.json"
        values = json.loads(path.read_text())
        path.write_text(json.dumps({**values, "num_episodes_between_training": episodes}))
        prepare(folder / "custom_files")
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("DR_")}
        own = {
            "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
            "DR_WORKERS": str(workers),
            "DR_LOCAL_S3_IDLE_MINUTES": "0",
            **settings,
        }
        self._head = subprocess.Popen(
            [PROGRAMS / "dr-start-training", "--foreground", "--seed", "1"],
            cwd=folder,
            env=self.environment | own,
            stdout=(folder / "head.txt").open("wb"),
            stderr=subprocess.STDOUT,
        )
        self._settings = load_settings(folder, environ={})

    def bucket(self) -> S3Bucket:
        """The bucket, directly."""
        return open_bucket(self._settings.storage)

    def join(
        self, name: str, round_trip_s: float, settings: Mapping[str, str] = MappingProxyType({})
    ) -> "Machine":
        """Let a machine join over a slow link, with more variables in its environment."""
        endpoint = server.ensure_running(self._settings.storage)
        assert endpoint.url is not None
        namespace = Namespace(len(self._namespaces)) if are_possible() else None
        if namespace is not None:
            self._namespaces.append(namespace)
        link = SlowLink(
            int(endpoint.url.rpartition(":")[2]),
            round_trip_s,
            RATE_BYTES_PER_S,
            "127.0.0.1" if namespace is None else namespace.address,
        )
        self._links.append(link)
        folder = self.folder / name
        folder.mkdir()
        keys_of_bucket = {
            "AWS_ACCESS_KEY_ID": endpoint.access_key or "",
            "AWS_SECRET_ACCESS_KEY": endpoint.secret_key or "",
        }
        model = f"s3://{self._settings.bucket}/{PREFIX}"
        program = str(PROGRAMS / "dr-start-worker")
        command = [program, "--join", model, "--endpoint-url", link.url, "--wait"]
        process = subprocess.Popen(
            command if namespace is None else namespace.command(command),
            cwd=folder,
            env=self.environment | keys_of_bucket | dict(settings),
            stdout=(folder / "said.txt").open("wb"),
            stderr=subprocess.STDOUT,
        )
        self._machines.append(process)
        return Machine(process, link, namespace)

    def trainer(self) -> psutil.Process:
        """The process of the trainer."""
        found = psutil.Process(self._head.pid).children(recursive=True)
        return next(each for each in found if each.cmdline()[-1].endswith("train.trainer"))

    def done(self) -> tuple[int, int]:
        """Iterations and steps that were learned from."""
        newest = CheckpointStore(ModelStore(self.bucket(), PREFIX)).pointed()
        return (0, 0) if newest is None else (newest.number, newest.steps)

    def wait_for(self, condition: Callable[[], bool], patience_s: float = 120.0) -> None:
        """Wait until the condition holds."""
        end_s = time.monotonic() + patience_s
        while not condition():
            if time.monotonic() > end_s:
                raise SystemExit(f"Waited in vain; look into {self.folder}.")
            time.sleep(0.2)

    def speed(self, seconds: float) -> dict[str, float]:
        """Iterations and steps per second in the next time."""
        began_s, (iterations, steps) = time.monotonic(), self.done()
        time.sleep(seconds)
        took_s, (later, more) = time.monotonic() - began_s, self.done()
        return {
            "iterations_per_s": round((later - iterations) / took_s, 3),
            "steps_per_s": round((more - steps) / took_s, 1),
        }

    def shares(self) -> list[int]:
        """How many episodes each worker that has a share drives."""
        path = self.folder / "data" / "s3" / self._settings.bucket / "runs" / PREFIX / "shares.json"
        try:
            newest = json.loads(path.read_text())["newest"]
        except (OSError, ValueError):
            return []
        return [share["count"] for share in newest[-1]["workers"]] if newest else []

    def drivers(self) -> int:
        """How many workers have a share."""
        return len(self.shares())

    def close(self) -> None:
        """End everything."""
        for link in self._links:
            link.is_cut = False
        for namespace in self._namespaces:
            namespace.set_link(up=True)
        for process in (self._head, *self._machines):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
        try:
            for process in (self._head, *self._machines):
                process.wait(60.0)
        finally:
            for link in self._links:
                link.close()
            for namespace in self._namespaces:
                namespace.close()
            server.stop(self._settings.storage)


@dataclass(frozen=True)
class Machine:
    """A machine that joins.

    Attributes:
        process: Its command.
        link: Its way to the bucket.
        namespace: Where it runs; None on the loopback interface.
    """

    process: "subprocess.Popen[bytes]"
    link: SlowLink
    namespace: Namespace | None

    def cut(self, *, off: bool) -> None:
        """Cut it off from the bucket, or connect it again."""
        if self.namespace is None:
            self.link.is_cut = off
        else:
            self.namespace.set_link(up=not off)

    def kill(self) -> None:
        """Kill its processes, which cannot tell anybody."""
        for process in (*psutil.Process(self.process.pid).children(), self.process):
            process.kill()


def kind_of_network() -> str:
    """How the machines of a training reach the bucket; the namespaces of others are deleted."""
    if not are_possible():
        return "loopback interface (namespaces need Linux, root and iproute2)"
    delete_left_over()
    return "a network namespace for each machine"


@contextmanager
def training(episodes: int, workers: int = 0) -> Iterator[Training]:
    """A training in a folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="joined-") as folder:
        running = Training(Path(folder), episodes, workers)
        try:
            yield running
        finally:
            running.close()


def worker_of(machine: subprocess.Popen[bytes]) -> psutil.Process:
    """The simulation process of a machine."""
    return psutil.Process(machine.pid).children()[0]


def slowed(process: psutil.Process, over: threading.Event) -> None:
    """Let a process run a tenth of the time."""
    while not over.is_set():
        process.suspend()
        over.wait(0.18)
        process.resume()
        over.wait(0.02)


def links(seconds: float, episodes: int) -> dict[str, dict[str, float]]:
    """One worker: on the training's own machine, and over links of growing delay."""
    found = {}
    with training(episodes, workers=1) as running:
        running.wait_for(lambda: running.done()[0] >= 3)
        found["own machine"] = running.speed(seconds)
    for round_trip_s in ROUND_TRIPS_S:
        with training(episodes) as running:
            running.join("far", round_trip_s)
            running.wait_for(lambda: running.done()[0] >= 3)
            found[f"{1000.0 * round_trip_s:.0f} ms"] = running.speed(seconds)
    return found


def faults(seconds: float, episodes: int) -> dict[str, dict[str, float]]:
    """Three machines, one of which is killed, cut off, or ten times as slow as the others."""
    found = {}
    with training(episodes) as running:
        machines = [running.join(f"far-{k}", each) for k, each in enumerate(ROUND_TRIPS_S)]
        running.wait_for(lambda: running.drivers() == len(machines))
        found["three machines"] = running.speed(seconds)
        over = threading.Event()
        slow = threading.Thread(target=slowed, args=(worker_of(machines[2].process), over))
        slow.start()
        found["one is 10 times as slow"] = running.speed(seconds)
        over.set()
        slow.join()
        running.wait_for(lambda: running.drivers() == len(machines), 300.0)
        machines[1].cut(off=True)
        found["one is cut off"] = running.speed(60.0)
        machines[1].cut(off=False)
        running.wait_for(lambda: running.drivers() == len(machines), 300.0)
        found["it is back"] = running.speed(seconds)
        machines[0].kill()
        found["one is killed"] = running.speed(seconds)
    return found


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement")
    parser.add_argument("--episodes", type=int, default=30, help="of an iteration")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that namespaces are deleted
    network = kind_of_network()
    result = {
        "network": network,
        "links": links(arguments.seconds, arguments.episodes),
        "faults": faults(arguments.seconds, arguments.episodes),
        "machine": facts(),
    }
    if arguments.json:
        print(json.dumps(result))
        return
    print(network)
    for name in ("links", "faults"):
        for case, speed in result[name].items():
            print(
                f"{case:26} {speed['iterations_per_s']:7.2f} iterations/s"
                f" {speed['steps_per_s']:8.1f} steps/s"
            )


if __name__ == "__main__":
    main()
