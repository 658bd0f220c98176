"""Trains on a Ray cluster of simulated nodes, one of which is killed at random again and again.

Ray places the trainer, too, so that its node is among them. Needs the extra: `pip install
'drcli[ray]'`. All nodes are processes of this machine.
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from machine import facts

from drcli.bucket.server import server
from drcli.config.loading import load_settings

ROOT = Path(__file__).resolve().parents[2]
PREFIX = "ray-nodes"


LATER_S = 5.0
"""When another node comes after one was killed."""


class KilledNodes:
    """Kills a random node of a cluster at intervals, and adds another one a moment later.

    Only in the main thread, as Ray wants it.
    """

    def __init__(self, cluster: Any, nodes: int, every_s: float, seed: int) -> None:
        self._cluster = cluster
        self._every_s = every_s
        self._chance = random.Random(seed)
        self._nodes = [cluster.add_node(num_cpus=1) for _ in range(nodes)]
        self._count = nodes
        self._killed_s = time.monotonic()
        self.killed = 0

    def look(self) -> None:
        """Kill or add a node if it is time for it."""
        since_s = time.monotonic() - self._killed_s
        if since_s >= self._every_s:
            node = self._nodes.pop(self._chance.randrange(len(self._nodes)))
            self._cluster.remove_node(node, allow_graceful=False)
            self.killed += 1
            self._killed_s = time.monotonic()
        elif since_s >= LATER_S and len(self._nodes) < self._count:
            try:
                self._nodes.append(self._cluster.add_node(num_cpus=1))
            except Exception as error:  # Ray has no other kind for it
                sys.stderr.write(f"A node did not start, which is tried again: {error}\n")


def main() -> None:
    """Train until laps are fast, and tell what was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--every", type=float, default=20.0, help="seconds between two kills")
    parser.add_argument("--lap-time", type=float, default=8.0, help="of evaluation laps")
    parser.add_argument("--minutes", type=float, default=12.0, help="the most to train")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    os.environ.setdefault("RAY_AUTH_MODE", "disabled")
    from ray.cluster_utils import Cluster

    folder = Path(tempfile.mkdtemp(prefix="ray-nodes-"))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = KilledNodes(cluster, chosen.nodes, chosen.every, chosen.seed)
    try:
        found = _train(folder, cluster.address, nodes, chosen)
    finally:
        cluster.shutdown()
        shutil.rmtree(folder)
    found |= {"killed nodes": nodes.killed}
    if chosen.json:
        print(json.dumps({**facts(), **found}))
    else:
        print("\n".join(f"{name}: {value}" for name, value in found.items()))


def _train(
    folder: Path, address: str, nodes: KilledNodes, chosen: argparse.Namespace
) -> dict[str, Any]:
    shutil.copy(ROOT / "run.env", folder)
    shutil.copy(ROOT / "system.env", folder)
    shutil.copytree(ROOT / "defaults" / "rewards" / "speed", folder / "custom_files")
    plain = {name: text for name, text in os.environ.items() if not name.startswith("DR_")}
    own = {
        "DR_LAUNCHER": "ray",
        "DR_RAY_ADDRESS": address,
        "DR_RAY_TRAINER": "cluster",
        "DR_WORKERS": str(chosen.nodes - 1),
        "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
        "DR_TRAIN_SEED": str(chosen.seed),
    }
    program = Path(sys.executable).parent
    limits = ["--until-lap-time", str(chosen.lap_time), "--max-minutes", str(chosen.minutes)]
    out = folder / "training.txt"
    began_s = time.monotonic()
    training = subprocess.Popen(
        [program / "dr-start-training", "--foreground", "--json", *limits],
        cwd=folder,
        env=plain | own,
        stdout=out.open("wb"),
        stderr=subprocess.STDOUT,
    )
    try:
        while training.poll() is None:
            nodes.look()
            time.sleep(0.5)
    finally:
        training.terminate()
        training.wait()
        server.stop(load_settings(folder).storage)
    said = out.read_text()
    took_s = time.monotonic() - began_s
    found = [line for line in said.splitlines() if line.startswith("{")]
    if not found:
        sys.exit(said)
    report = json.loads(found[-1])
    history = report["history"]
    numbers = [record["iteration"] for record in history]
    trainer = (folder / "data" / "logs" / "sagemaker" / PREFIX / "trainer.log").read_text()
    logs = sorted((folder / "data" / "logs" / "robomaker" / PREFIX).glob("joined-*.log"))
    words = (folder / "data" / "logs" / "sagemaker" / PREFIX / "ray.log").read_text()
    return {
        "exit code": training.returncode,
        "end": report["message"],
        "seconds": round(took_s, 1),
        "iterations": len(history),
        "iterations missing or twice": len(range(len(history))) - len(set(numbers)),
        "iterations with episodes left out": sum(
            record["episodes"] < history[0]["episodes"] for record in history
        ),
        "steps": history[-1]["total_steps"],
        "steps missing": history[-1]["total_steps"] - sum(record["steps"] for record in history),
        "workers placed again": words.count("placed again"),
        "trainer placed again": trainer.count("The trainer runs on") - 1,
        "checkpoints in the log of the trainer": trainer.count("Checkpoint> Saving"),
        "workers that joined": len(set(re.findall(r" as (joined-[\w-]+)", words))),
        "logs of workers that can be read": sum(bool(log.read_text()) for log in logs),
    }


if __name__ == "__main__":
    main()
