"""What a teacher brings: time and laps of trainings with one, beside those without, in turn.

    python scripts/bench teacher [--worlds NAME ...] [--lap-times 8.0 6.5] [--seeds 1 2 3 4 5]
        [--minutes 5] [--files FOLDER] [--only-teacher] [--peers sb3-ppo sb3-sac cleanrl] [--json]

Each training is one of `bench goal`: the real commands in an empty folder, until all evaluation
laps take at most the lap time, and then 40 fresh laps of the best checkpoint. The table has medians
over the seeds. With --json the last line of stdout is one object with `trainings`, a list of the
results of `bench goal`, each with `world`, `lap_time` and `method`: "a teacher", "no teacher", or a
peer.

Peers are trainings of others on the same cars, track, reward, actions and cores, also in turn and
with the same longest time: Stable-Baselines3's PPO and SAC (`pip install stable-baselines3`), and
PPO in the manner of CleanRL. `bench learn_lap_sb3` says how they are trained and judged. Their
evaluations count neither as time nor as processor time, while ours do. If they did not reach the
lap time, their fresh laps are the last policy's.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

from goal import run_seed
from lap import PROJECT
from learn_lap_sb3 import PEERS
from machine import print_json

FRESH_LAPS = 40

TEACHER, ALONE = "a teacher", "no teacher"
"""Our trainings, as the table calls them."""


def main() -> None:
    """Train with and without a teacher in turn, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=["reinvent_base"])
    parser.add_argument("--lap-times", nargs="+", type=float, default=[8.0, 6.5])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--minutes", type=float, default=5.0, help="longest training")
    parser.add_argument("--files", type=Path, default=PROJECT / "defaults" / "rewards" / "speed")
    parser.add_argument("--only-teacher", action="store_true", help="leave ours without out")
    parser.add_argument("--peers", nargs="+", choices=PEERS, default=[], help="others' trainings")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    needs_sb3 = any(peer.startswith("sb3") for peer in options.peers)
    if needs_sb3 and importlib.util.find_spec("stable_baselines3") is None:
        parser.error("No Stable-Baselines3 to compare with: pip install stable-baselines3")
    methods = [TEACHER, *([] if options.only_teacher else [ALONE]), *options.peers]
    found: list[dict[str, Any]] = []
    for world in options.worlds:
        for lap_time in options.lap_times:
            for seed in options.seeds:
                for method in methods:
                    own = {"world": world, "lap_time": lap_time, "method": method}
                    each = argparse.Namespace(
                        **own,
                        teacher=method == TEACHER,
                        minutes=options.minutes,
                        laps=FRESH_LAPS,
                        files=options.files,
                    )
                    train = _train_peer if method in PEERS else run_seed
                    found.append(own | train(seed, each))
                    print(json.dumps(found[-1]), file=sys.stderr, flush=True)
            for method in methods:
                print(_line(world, lap_time, method, found), flush=True)
    if options.json:
        print_json({"trainings": found})


def _train_peer(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Train one of the others in a process of its own, as its users would run it."""
    words = {
        "--peer": options.method,
        "--lap-time": options.lap_time,
        "--reward": options.files,
        "--seed": seed,
        "--minutes": options.minutes,
        "--world": options.world,
    }
    script = Path(__file__).with_name("learn_lap_sb3.py")
    command = [sys.executable, script, *(word for option in words.items() for word in option)]
    done = subprocess.run([*map(str, command)], check=True, stdout=subprocess.PIPE, text=True)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _line(world: str, lap_time: float, method: str, found: list[dict[str, Any]]) -> str:
    """The medians of one kind of training."""
    kind = {"world": world, "lap_time": lap_time, "method": method}
    own = [each for each in found if kind.items() <= each.items()]
    times = [median(each[name] for each in own) for name in ("train_s", "cpu_s", "kept")]
    laps = [each["median_s"] for each in own if each["median_s"] is not None]
    return (
        f"{world}, laps of {lap_time:g} s, {method}: "
        f"{sum(each['reached'] for each in own)} of {len(own)} reached it, {times[0]:.0f} s, "
        f"{times[1]:.0f} processor seconds, {times[2]:.0f} of {FRESH_LAPS} fresh laps hold it"
        + (f", median lap {median(laps):.2f} s" if laps else "")
    )


if __name__ == "__main__":
    main()
