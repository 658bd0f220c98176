"""Whether machines that join over slow links train the same weights as workers of the training.

Two trainings have the same seed and the same parts: one drives itself, and for the other, as many
machines drive behind links of 1, 20 and 100 ms and 50 Mbit/s. Exits with 1 if they differ.
"""

import argparse
import hashlib
import json
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

import psutil
from joined import PREFIX, ROUND_TRIPS_S, Machine, Training, kind_of_network

from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_shares_record
from drcli.records.job import MemberRecord

EPISODES = 12
ITERATIONS = 4
SETTINGS = {"DR_TRAIN_OVERLAP": "off", "DR_TRAIN_SHARES": "equal"}


def few_iterations(custom: Path) -> None:
    """Let the training end after a few iterations."""
    path = custom / "hyperparameters.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, "term_cond_max_episodes": ITERATIONS}))


def trained(machines: int) -> dict[str, Any]:
    """What a training has learned, driven by so many machines that join, or by itself if 0."""
    workers = 0 if machines else len(ROUND_TRIPS_S)
    with tempfile.TemporaryDirectory(prefix="sums-") as folder:
        training = Training(Path(folder), EPISODES, workers, few_iterations, SETTINGS)
        try:
            joined = [
                training.join(f"far-{number}", ROUND_TRIPS_S[number]) for number in range(machines)
            ]
            if joined:
                begin_together(training, joined)
            training.wait_for(lambda: training.done()[0] >= ITERATIONS, 600.0)
            return learned(training)
        finally:
            training.close()


def begin_together(training: Training, machines: list[Machine]) -> None:
    """Let the first iteration wait until all machines are ready, so that they get equal parts."""
    held: dict[str, psutil.Process] = {}

    def are_held() -> bool:
        record = read_shares_record(ModelStore(training.bucket(), PREFIX))
        numbers = {} if record is None else record.numbers
        for machine in machines:
            for worker in psutil.Process(machine.process.pid).children():
                member = worker.cmdline()[-1]
                if member in numbers and member not in held:
                    worker.suspend()
                    held[member] = worker
        return len(held) == len(machines)

    def are_ready() -> bool:
        bucket = training.bucket()
        found = bucket.list(keys.members_folder(PREFIX))
        return all(MemberRecord.decode(bucket.get(info.key)).ready for info in found)

    training.wait_for(are_held)
    trainer = training.trainer()
    trainer.suspend()
    for worker in held.values():
        worker.resume()
    training.wait_for(are_ready)
    trainer.resume()


def learned(training: Training) -> dict[str, Any]:
    """Sums of all iterations, and the weights in the end."""
    bucket = training.bucket()
    name = CheckpointStore(ModelStore(bucket, PREFIX)).pointed()
    weights = CheckpointStore(ModelStore(bucket, PREFIX)).load(str(name)).tensors
    return {
        "iterations": [
            (each.total_steps, each.mean_reward, each.mean_progress)
            for each in read_history(ModelStore(bucket, PREFIX))
        ],
        "weights": hashlib.sha256(weights).hexdigest(),
    }


def main() -> None:
    """Train twice and compare."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that namespaces are deleted
    print(kind_of_network())
    alone, joined = trained(0), trained(len(ROUND_TRIPS_S))
    for name, result in (("alone", alone), ("joined", joined)):
        print(f"{name:8}", *result["iterations"], f"weights {result['weights'][:16]}", sep="\n  ")
    if alone != joined:
        raise SystemExit("They differ.")
    print("They are the same, to the last bit.")


if __name__ == "__main__":
    main()
