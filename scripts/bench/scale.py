"""What many workers bring: measured with real ones whose cost is sleep, then by a model.

--measure trains with 1, 2, 4 and 8 workers that join through the bucket. Their reward function
sleeps, so that they do not share the processor, and writes figures to a file. Without it, the model
of scale_model.py is compared with these figures and extrapolated; --pictures draws its curves.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from joined import PREFIX, Training
from machine import facts
from scale_model import Costs, Outcome, Setup, predicted

from drcli.exchange.episode_metrics import decode_metrics
from drcli.store.history import read_history
from drcli.store.s3_bucket import S3Bucket

FIGURES = Path(__file__).with_name("scale_figures.json")

WORKERS = (1, 2, 4, 8)
LAGS = (0, 1, 4)
"""DR_TRAIN_MAX_LAG, 0 for DR_TRAIN_OVERLAP=off."""

SLEEP_S = 0.04
"""Of the reward function at each step: ten times the processor time of a step with one car."""

EPISODES = 80
"""Of an iteration: eight workers drive ten each."""

EPOCHS = 3
"""num_epochs of hyperparameters.json."""

SKIPPED = 2
"""First iterations with all workers, which do not count, besides those that were driven ahead."""

SATURATED = 0.95
"""Time of the learner for an iteration in the last measurement, as a share of that of the drive."""

REQUESTS = 60
"""Of each kind, to measure the bucket."""

MANY = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 3000, 10_000)

WORKER_USD, TRAINER_USD = 0.036, 0.80
"""Price per hour of a spot machine with two cores, which drives, and of one with a GPU, which
learns: about the prices of c7i.large (spot) and g5.xlarge (on demand 1.006, spot 0.4 to 0.8) in
us-east-1 in 2026. `dr-spot prices` asks for today's."""

PUT_USD, GET_USD = 0.005 / 1000, 0.0004 / 1000
EGRESS_USD_PER_GB = 0.02
"""Between two regions of Amazon, list price; within one region it is free."""

GPU = Costs(
    round_trip_s=0.02,
    put_s=0.02,
    get_s=0.01,
    list_s=0.03,
    worker_bytes_per_s=100e6,
    trainer_bytes_per_s=1.2e9,
    puts_per_s=3500.0,
    gets_per_s=5500.0,
    spread=0.1,
    learn_step_s=1.0 / 20_000.0,
)
"""Amazon's S3 in one region, and a trainer with a GPU. Sources: S3's documentation for its limits
per prefix; latencies and 20,000 steps/s of learning are assumptions, not measurements."""


def main() -> None:
    """Measure or predict, and print tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--measure", action="store_true", help="with real workers; ten minutes")
    parser.add_argument("--figures", type=Path, default=FIGURES, help="file of the figures")
    parser.add_argument("--workers", type=int, nargs="+", default=WORKERS)
    parser.add_argument("--lags", type=int, nargs="+", default=LAGS)
    parser.add_argument("--repeat", type=int, default=1, help="measurements of each kind")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement")
    parser.add_argument("--most", type=int, default=10_000, help="workers of the curves")
    parser.add_argument("--pictures", type=Path, help="folder for the curves")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    if chosen.measure:
        measure(chosen)
    figures = json.loads(chosen.figures.read_text())
    checked, curves = check(figures), extrapolate(figures, chosen.most)
    if chosen.pictures is not None:
        from scale_pictures import draw

        draw(curves, chosen.pictures)
    if chosen.json:
        print(json.dumps({"measured": figures, "checked": checked, "curves": curves}))
        return
    _table(checked)
    for name, rows in curves.items():
        print(f"\n{name}")
        _table(rows)


# --- Measured with real workers --------------------------------------------------------------


def measure(chosen: argparse.Namespace) -> None:
    """Train with so many workers and such a lag each time, and add what comes to the file.

    What is in the file is not measured again.
    """
    found: dict[str, Any] = {"sleep_s": SLEEP_S, "episodes": EPISODES, "runs": []}
    if chosen.figures.exists():
        found = json.loads(chosen.figures.read_text())
    found["machine"] = facts()
    wanted = [(count, lag, EPOCHS) for lag in chosen.lags for count in chosen.workers]
    for count, lag, epochs in wanted * chosen.repeat:
        found["runs"].append(_train(count, chosen.seconds, lag, epochs))
        print(json.dumps(found["runs"][-1]), file=sys.stderr)
        chosen.figures.write_text(json.dumps(found, indent=1) + "\n")


def _sleeping(custom: Path, epochs: int) -> None:
    """Let each step cost sleep, and the policy stay as it is, so that iterations stay equal."""
    (custom / "reward_function.py").write_text(
        f"import time\n\ndef reward_function(params):\n    time.sleep({SLEEP_S})\n    return 1.0\n"
    )
    path = custom / "hyperparameters.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "lr": 1e-8, "num_epochs": epochs}))


def _train(workers: int, seconds: float, lag: int, epochs: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="scale-") as folder:
        settings = {
            "DR_TRAIN_OVERLAP": "on" if lag else "off",
            "DR_TRAIN_MAX_LAG": str(max(1, lag)),
            "DR_TRAIN_EVAL_SHARE": "0.001",
        }
        sleeping = partial(_sleeping, epochs=epochs)
        training = Training(Path(folder), EPISODES, 0, sleeping, settings)
        try:
            for number in range(workers):
                training.join(f"worker-{number}", 0.0)
            training.wait_for(lambda: training.drivers() == workers, 300.0)
            first = training.done()[0] + SKIPPED + lag
            training.wait_for(lambda: training.done()[0] > first, 300.0)
            before = _requests(training)
            began = training.done()[0]
            time.sleep(seconds)
            training.wait_for(lambda: training.done()[0] >= began + 3, 300.0)
            ended, after = training.done()[0], _requests(training)
            latency = _latency(training.bucket())
            records = read_history(training.bucket(), PREFIX)[began + 1 : ended]
            lengths = _lengths(training)
        finally:
            training.close()
    took_s = [later.elapsed_s - earlier.elapsed_s for earlier, later in pairwise(records)]
    steps = statistics.fmean(record.steps for record in records)
    count = ended - began
    return {
        "workers": workers,
        "ahead": lag,
        "epochs": epochs,
        "load": os.getloadavg()[1],
        "iterations": len(records),
        "iteration_s": statistics.fmean(took_s),
        "steps": steps,
        "drive_s": statistics.fmean(record.drive_s for record in records),
        "learn_s": statistics.fmean(record.learn_s for record in records),
        "episode_spread": statistics.pstdev(lengths) / statistics.fmean(lengths),
        **{name: (after[name] - before[name]) / count for name in after},
        **latency,
    }


def _lengths(training: Training) -> list[float]:
    """Steps of all training episodes: each pays a reward of 1."""
    metrics = (training.folder / "data" / "s3").rglob("TrainingMetrics*.json")
    episodes = [each for path in metrics for each in decode_metrics(path.read_bytes())]
    return [each.reward_score for each in episodes if each.phase == "training"]


def _requests(training: Training) -> dict[str, float]:
    """Requests and bytes of trainer and workers so far, from their own counts."""
    found = {"puts": 0.0, "gets": 0.0, "sent_bytes": 0.0, "received_bytes": 0.0}
    for path in training.folder.rglob("*.requests.json"):
        try:
            counted = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        for name in found:
            found[name] += counted[name]
    return found


def _latency(bucket: S3Bucket) -> dict[str, float]:
    """Median time of a request of each kind, seconds."""

    def median(call: Any) -> float:
        times = []
        for number in range(REQUESTS):
            began_s = time.perf_counter()
            call(number)
            times.append(time.perf_counter() - began_s)
        return statistics.median(times)

    return {
        "put_s": median(lambda number: bucket.put(f"scale-test/{number}", b"x" * 1000)),
        "get_s": median(lambda number: bucket.get(f"scale-test/{number}")),
        "list_s": median(lambda _: bucket.list("scale-test/")),
    }


# --- By the model ----------------------------------------------------------------------------


def costs_of(run: dict[str, Any], episodes: int) -> Costs:
    """The costs of a measured training with one worker."""
    steps = run["steps"]
    plain = Costs(
        put_s=run["put_s"],
        get_s=run["get_s"],
        list_s=run["list_s"],
        weights_bytes=2.5e6,
        state_bytes=5e6,
        step_bytes=(run["sent_bytes"] - 7.5e6) / steps if run["sent_bytes"] > 8e6 else 5e3,
        step_s=run["drive_s"] / steps,
        learn_step_s=run["learn_s"] / steps,
        episode_steps=steps / episodes,
    )
    # What is left is time of the processes between requests: the model is told it once, for one
    # worker, and predicts the others.
    alone = predicted(plain, _here(1, episodes, run["ahead"]), iterations=10)
    left_s = max(0.0, run["iteration_s"] - 1.0 / alone.iterations_per_s)
    return replace(plain, learn_s=left_s)


def _here(workers: int, episodes: int, ahead: int) -> Setup:
    """The setup of the measurement: a bucket of this machine is looked at often."""
    return Setup(workers, episodes, ahead, look_s=0.25, members_s=5.0)


def check(figures: dict[str, Any]) -> list[dict[str, Any]]:
    """The model beside what was measured; it knows only the first of each kind."""
    rows = []
    for ahead in (0, 1):
        runs = [run for run in figures["runs"] if run["ahead"] == ahead]
        costs = costs_of(runs[0], figures["episodes"])
        for run in runs:
            setup = _here(run["workers"], figures["episodes"], ahead)
            model = predicted(costs, setup, iterations=10)
            measured = 1.0 / run["iteration_s"]
            # Iterations differ a little in their steps.
            speed, alone = run["steps"] / run["iteration_s"], runs[0]["steps"]
            rows.append(
                {
                    "workers": run["workers"],
                    "overlap": "on" if ahead else "off",
                    "iterations/s": round(measured, 3),
                    "model": round(model.iterations_per_s, 3),
                    "error %": round(100.0 * (model.iterations_per_s / measured - 1.0), 1),
                    "efficiency": round(speed * runs[0]["iteration_s"] / alone / run["workers"], 3),
                    "learner idle %": round(100.0 * (1.0 - run["learn_s"] / run["iteration_s"])),
                    "requests/iteration": round(run["puts"] + run["gets"]),
                }
            )
    return rows


def extrapolate(figures: dict[str, Any], most: int) -> dict[str, list[dict[str, Any]]]:
    """Curves on Amazon for several settings, up to so many workers."""
    alone = figures["runs"][0]
    costs = replace(
        GPU,
        weights_bytes=2.5e6,
        state_bytes=5e6,
        step_bytes=costs_of(alone, figures["episodes"]).step_bytes,
        episode_steps=150.0,
        # A worker with two cores makes about 800 steps/s in a training.
        step_s=1.0 / 800.0,
        learn_s=0.15,
    )
    today = Setup(ahead=1, manifest_reads=16, part_reads=16, member_reads=16)
    before = replace(today, manifest_reads=1, part_reads=2, member_reads=1)
    cases = {
        "20 episodes an iteration, as shipped": replace(today, episodes=20),
        "100 episodes an iteration": replace(today, episodes=100),
        "as many episodes as workers, 100 at least": today,
        "the same, objects read one after the other": before,
    }
    return {
        name: [
            _row(costs, setup, workers, grows="as" in name.split()[0] or "same" in name)
            for workers in MANY
            if workers <= most
        ]
        for name, setup in cases.items()
    }


def _row(costs: Costs, setup: Setup, workers: int, *, grows: bool) -> dict[str, Any]:
    if grows:
        setup = replace(setup, episodes=max(100, workers))
    setup = replace(setup, workers=workers)
    model = predicted(costs, setup, iterations=2 if workers > 500 else 8)
    return {"workers": workers, "episodes": setup.episodes, **_told(model, workers)}


def _told(model: Outcome, workers: int) -> dict[str, Any]:
    steps_per_h = 3600.0 * model.steps_per_s
    writes, reads = model.requests["put"] + model.requests["list"], model.requests["get"]
    requests = (PUT_USD * writes + GET_USD * reads) / model.steps * 1e6
    machines = (WORKER_USD * workers + TRAINER_USD) / steps_per_h * 1e6
    between = EGRESS_USD_PER_GB * (model.sent_bytes + model.received_bytes) / 1e9
    waits = ", ".join(
        f"{name} {100.0 * seconds / model.seconds:.0f} %"
        for name, seconds in model.waits_s.most_common(2)
    )
    return {
        "iterations/s": round(model.iterations_per_s, 3),
        "steps/s": round(model.steps_per_s),
        "puts/s": round(writes / model.seconds, 1),
        "gets/s": round(reads / model.seconds, 1),
        "GB/h": round(3.6e-6 * (model.sent_bytes + model.received_bytes) / model.seconds, 1),
        "learner idle %": round(100.0 * model.learner_idle),
        "worker idle %": round(100.0 * model.worker_idle),
        "USD per million steps": round(machines + requests, 2),
        "of that requests": round(requests, 2),
        "between regions, more": round(between / model.steps * 1e6, 2),
        "the trainer's time": waits,
    }


def _table(rows: list[dict[str, Any]]) -> None:
    widths = {name: max(len(name), *(len(str(row[name])) for row in rows)) for name in rows[0]}
    print("  ".join(name.rjust(width) for name, width in widths.items()))
    for row in rows:
        print("  ".join(str(row[name]).rjust(width) for name, width in widths.items()))


if __name__ == "__main__":
    main()
