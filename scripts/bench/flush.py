"""What it costs to bring checkpoints to the disk before the workers see them.

    python scripts/bench flush [--saves 40] [--folder PATH] [--json]

Publishes checkpoints of the shipped network on the embedded server, as a trainer does, in pairs:
the weights alone, unflushed, and then with the optimizer state and flushed. The workers wait for
this. Prints the medians and the share of an iteration (--iteration-s, with the shipped
hyperparameters 8 s on two cores).
"""

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path

from machine import print_json

from drcli.bucket.connect import open_bucket
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

WEIGHTS_BYTES = 1_215_476
"""Of the shipped network; the optimizer state is twice as large."""


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(prog="bench flush", description=__doc__)
    parser.add_argument("--saves", type=int, default=40, help="pairs")
    parser.add_argument("--folder", type=Path, help="on the disk to measure")
    parser.add_argument("--iteration-s", type=float, default=8.0, help="length of an iteration")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        config = StorageConfig("local", "bench", Path(folder))
        bucket = open_bucket(config)
        try:
            pairs = [_pair(bucket, number) for number in range(1, options.saves + 1)]
        finally:
            server.stop(config)
    without, with_flush = (statistics.median(each) for each in zip(*pairs, strict=True))
    cost_s = statistics.median(after - before for before, after in pairs)
    found = {
        "without_ms": 1e3 * without,
        "with_ms": 1e3 * with_flush,
        "cost_ms": 1e3 * cost_s,
        "steps_per_s_ratio": options.iteration_s / (options.iteration_s + cost_s),
    }
    if options.json:
        print_json(found)
    else:
        print("".join(f"{name:20} {value:8.3f}\n" for name, value in found.items()), end="")


def _pair(bucket: S3Bucket, number: int) -> tuple[float, float]:
    """Seconds until the pointer is written: weights alone and unflushed, then as it is done now."""
    weights, moments = os.urandom(WEIGHTS_BYTES), os.urandom(2 * WEIGHTS_BYTES)
    began_s = time.perf_counter()
    bucket.put(keys.checkpoint_tensors("old", f"{number}_Step-{number}.ckpt"), weights)
    bucket.put(keys.checkpoint_record("old", f"{number}_Step-{number}.ckpt"), b"{}")
    bucket.put(keys.coach_checkpoint("old"), b"0_Step-0.ckpt")
    without_s = time.perf_counter() - began_s
    bucket.flush()

    pointed: list[float] = []
    began_s = time.perf_counter()
    CheckpointStore(ModelStore(bucket, "new")).save(
        number,
        number,
        weights,
        optimizer=moments,
        on_pointed=lambda: pointed.append(time.perf_counter() - began_s),
    )
    bucket.flush()
    return without_s, pointed[0]


if __name__ == "__main__":
    main()
