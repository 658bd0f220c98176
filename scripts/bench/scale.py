"""What many workers bring: measured with workers whose cost is sleep, then by a model.

--fakes trains with 1, 2, 4 and 8 workers in one process, where driving, learning and requests only
wait (scale_fakes.py): efficiency and idle time, without and with a lag. --measure trains with
real processes that join through the bucket, whose reward function sleeps. Both write figures to a
file. Without them, the model of scale_model.py is compared with these figures and extrapolated;
--pictures draws its curves.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from joined import PREFIX, Training
from machine import facts
from scale_fakes import EPISODE_SPREAD, EPISODE_STEPS, GET_S, LIST_S, PUT_S
from scale_model import Costs, Outcome, Setup, predicted

from drcli.bucket.s3_bucket import S3Bucket
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore

FIGURES = Path(__file__).with_name("scale_figures.json")

WORKERS = (1, 2, 4, 8)
LAGS = (0, 1, 2, 4)
"""DR_TRAIN_MAX_LAG, 0 for DR_TRAIN_OVERLAP=off."""

SLEEP_S = 0.04
EPISODES = 40
SKIPPED = 2
"""First iterations with all workers, which do not count."""

FAKE_EPISODES = 80
"""Of an iteration of those whose cost is sleep: eight workers drive ten each."""

FAKE_STEP_S, QUICK_STEP_S = 0.05, 0.0005
"""Time of a worker for a step, and of a learner that is always quick enough."""

SATURATED_STEP_S = 0.95 * FAKE_STEP_S / max(WORKERS)
"""Time of a learner that eight workers keep busy."""

FAKE_S = 240.0
"""About how long each of these trainings takes, besides its beginning."""

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
    parser.add_argument("--fakes", action="store_true", help="in one process; ten minutes")
    parser.add_argument("--figures", type=Path, default=FIGURES, help="file of the figures")
    parser.add_argument("--workers", type=int, nargs="+", default=WORKERS)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement")
    parser.add_argument("--most", type=int, default=1000, help="workers of the curves")
    parser.add_argument("--pictures", type=Path, help="folder for the curves")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    figures = json.loads(chosen.figures.read_text()) if chosen.figures.exists() else {}
    if chosen.measure:
        figures |= measure(chosen.workers, chosen.seconds)
    if chosen.fakes:
        figures |= {"fakes": fakes(chosen.workers), "fakes_machine": facts()}
    if chosen.measure or chosen.fakes:
        chosen.figures.write_text(json.dumps(figures, indent=1) + "\n")
    checked = {
        "Real workers": check(figures["runs"], figures["episodes"], HERE),
        "Workers whose cost is sleep": check(figures["fakes"], FAKE_EPISODES, AWAY),
    }
    curves = extrapolate(figures, chosen.most)
    if chosen.pictures is not None:
        from scale_pictures import draw

        draw(curves, chosen.pictures)
    if chosen.json:
        print(json.dumps({"measured": figures, "checked": checked, "curves": curves}))
        return
    for name, rows in (checked | curves).items():
        print(f"\n{name}")
        _table(rows)


# --- Measured with real workers --------------------------------------------------------------


def measure(workers: Sequence[int], seconds: float) -> dict[str, Any]:
    """Train with so many workers each time; without and with overlap."""
    found: dict[str, Any] = {"sleep_s": SLEEP_S, "episodes": EPISODES, "machine": facts()}
    found["runs"] = [_train(count, seconds, ahead) for ahead in LAGS for count in workers]
    return found


def _sleeping(custom: Path) -> None:
    """Let each step cost sleep, and the policy stay as it is, so that iterations stay equal."""
    (custom / "reward_function.py").write_text(
        f"import time\n\ndef reward_function(params):\n    time.sleep({SLEEP_S})\n    return 1.0\n"
    )
    path = custom / "hyperparameters.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "lr": 1e-8}))


def _train(workers: int, seconds: float, ahead: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="scale-") as folder:
        settings = {
            "DR_TRAIN_OVERLAP": "on" if ahead else "off",
            "DR_TRAIN_MAX_LAG": str(max(1, ahead)),
            "DR_TRAIN_EVAL_SHARE": "0.001",
        }
        training = Training(Path(folder), EPISODES, 0, _sleeping, settings)
        try:
            for number in range(workers):
                training.join(f"worker-{number}", 0.0)
            training.wait_for(lambda: training.drivers() == workers, 300.0)
            first = training.done()[0] + SKIPPED + ahead
            training.wait_for(lambda: training.done()[0] > first, 300.0)
            before = _requests(training)
            began = training.done()[0]
            time.sleep(seconds)
            training.wait_for(lambda: training.done()[0] >= began + 3, 300.0)
            ended, after = training.done()[0], _requests(training)
            latency = _latency(training.bucket())
            records = read_history(ModelStore(training.bucket(), PREFIX))[began + 1 : ended]
        finally:
            training.close()
    took_s = [later.elapsed_s - earlier.elapsed_s for earlier, later in pairwise(records)]
    steps = statistics.fmean(record.steps for record in records)
    count = ended - began
    return {
        "workers": workers,
        "ahead": ahead,
        "iterations": len(records),
        "iteration_s": statistics.fmean(took_s),
        "steps": steps,
        "drive_s": statistics.fmean(record.drive_s for record in records),
        "learn_s": statistics.fmean(record.learn_s for record in records),
        **{name: (after[name] - before[name]) / count for name in after},
        **latency,
    }


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


# --- Measured with workers whose cost is sleep ---------------------------------------------------


def fakes(workers: Sequence[int]) -> list[dict[str, Any]]:
    """Train with so many workers and each lag, with a quick learner and with a busy one.

    All trainings run at the same time, because they only wait.
    """
    cases = [(count, lag, QUICK_STEP_S) for lag in LAGS for count in workers]
    cases += [(max(WORKERS), lag, SATURATED_STEP_S) for lag in LAGS]
    running = []
    for count, lag, learn_step_s in cases:
        iteration_s = FAKE_EPISODES * EPISODE_STEPS * FAKE_STEP_S / count
        iterations = 4 + 2 * lag + round(FAKE_S / iteration_s)
        given = {"workers": count, "lag": lag, "learn-step-s": learn_step_s}
        given |= {"iterations": iterations, "step-s": FAKE_STEP_S, "episodes": FAKE_EPISODES}
        options = [word for name, value in given.items() for word in (f"--{name}", str(value))]
        program = Path(__file__).with_name("scale_fakes.py")
        running.append(
            subprocess.Popen([sys.executable, str(program), *options], stdout=subprocess.PIPE)
        )
    return [json.loads(each.communicate()[0].splitlines()[-1]) for each in running]


# --- By the model ----------------------------------------------------------------------------

HERE = Setup(look_s=0.25, members_s=5.0)
"""Real workers of this machine, whose bucket is looked at often."""

AWAY = Setup(manifest_reads=16, part_reads=16, members_s=1e9, renew_s=1e9)
"""Workers whose cost is sleep, in a bucket where each look costs money."""


def costs_of(runs: Sequence[dict[str, Any]], episodes: int) -> Costs:
    """What trainings with one worker say about the costs."""
    alone = {run["ahead"]: run for run in runs if run["workers"] == 1}
    run = alone[0]
    steps = run["steps"]
    sent_bytes = run.get("sent_bytes", 0.0)
    costs = Costs(
        put_s=run.get("put_s", PUT_S),
        get_s=run.get("get_s", GET_S),
        list_s=run.get("list_s", LIST_S),
        weights_bytes=2.5e6,
        state_bytes=5e6,
        step_bytes=(sent_bytes - 7.5e6) / steps if sent_bytes > 8e6 else 5e3,
        step_s=run["drive_s"] / steps,
        learn_step_s=run["learn_s"] / steps,
        episode_steps=steps / episodes,
        episode_spread=EPISODE_SPREAD,
    )

    def left_s(ahead: int) -> float:
        even = replace(costs, episode_spread=0.0, episode_steps=alone[ahead]["steps"] / episodes)
        model = predicted(even, replace(HERE, episodes=episodes, ahead=ahead), iterations=10)
        return max(0.0, alone[ahead]["iteration_s"] - 1.0 / model.iterations_per_s)

    # What is left is time of the processes between requests. The model is told it once, for one
    # worker, and predicts the others: the worker's, who never waits if it may drive ahead, and the
    # trainer's, who adds to it if the two take turns.
    costs = replace(costs, drive_s=left_s(1))
    return replace(costs, learn_s=left_s(0))


def check(runs: Sequence[dict[str, Any]], episodes: int, setup: Setup) -> list[dict[str, Any]]:
    """The model beside what was measured; it knows only trainings with one worker."""
    costs = costs_of(runs, episodes)
    alone = {run["ahead"]: run["steps"] / run["iteration_s"] for run in runs if run["workers"] == 1}
    rows = []
    for run in runs:
        learn_step_s = run.get("learn_step_s", QUICK_STEP_S)
        busy = learn_step_s > QUICK_STEP_S
        known = replace(costs, learn_step_s=learn_step_s) if busy else costs
        own = replace(setup, workers=run["workers"], episodes=episodes, ahead=run["ahead"])
        model = predicted(known, own, iterations=100)
        speed = run["steps"] / run["iteration_s"]
        requests = [run[kind] for kind in ("put", "puts", "get", "gets", "list") if kind in run]
        rows.append(
            {
                "workers": run["workers"],
                "lag": run["ahead"],
                "learner": "busy" if busy else "quick",
                "steps/s": round(speed, 1),
                "model": round(model.steps_per_s, 1),
                "error %": round(100.0 * (model.steps_per_s / speed - 1.0), 1),
                "efficiency": round(speed / alone[run["ahead"]] / run["workers"], 3),
                "learner idle %": round(100.0 * (1.0 - run["learn_s"] / run["iteration_s"])),
                "model's idle %": round(100.0 * model.learner_idle),
                "requests/iteration": round(sum(requests)),
            }
        )
    return rows


def extrapolate(figures: dict[str, Any], most: int) -> dict[str, list[dict[str, Any]]]:
    """Curves on Amazon for several settings, up to so many workers."""
    costs = replace(
        GPU,
        weights_bytes=2.5e6,
        state_bytes=5e6,
        step_bytes=costs_of(figures["runs"], figures["episodes"]).step_bytes,
        episode_steps=150.0,
        episode_spread=0.5,
        # A worker with two cores makes about 800 steps/s in a training.
        step_s=1.0 / 800.0,
        learn_s=0.15,
    )
    today = Setup(ahead=1, manifest_reads=16, part_reads=16, member_reads=16)
    cases = {
        "20 episodes an iteration, as shipped": replace(today, episodes=20),
        "100 episodes an iteration": replace(today, episodes=100),
        "as many episodes as workers, 100 at least": today,
        "the same, DR_TRAIN_MAX_LAG=2": replace(today, ahead=2),
        "the same, and a tenth of the looks": replace(today, ahead=2, look_s=10.0, look_share=0.3),
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
    model = predicted(costs, setup, iterations=8 if workers <= 500 else 2 if workers <= 3000 else 1)
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
