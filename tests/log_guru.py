"""Reads a simulation log by the rules of log-guru 3.2, and fails where that would stop.

Its rules are facts about a desktop application that no package index has: which line it knows by
which beginning, what has to be counted without a gap, and what it divides by.
"""

import json
from dataclasses import dataclass, field

EARLY_LINES = 20
"""So many steps may come before the ones they follow; then it stops."""

ENDS = {"lap_complete", "off_track", "crashed", "reversed", "immobilized"}

REWARD = "## agent: Finished evaluation phase. Success rate = 0.0, Avg Total Reward = "
PROGRESS = "[BestModelSelection] Number of evaluations: "
ACTIONS = "Action space from file: "
NUMBERS = ("batch_size", "beta_entropy", "discount_factor", "lr", "num_epochs")


@dataclass
class Reading:
    """What it shows of a log."""

    model: str = ""
    parameters: dict[str, str] = field(default_factory=dict)
    hyperparameters: dict[str, str] = field(default_factory=dict)
    continuous: bool = False
    actions: list | dict = field(default_factory=list)
    episodes: list[list[dict[str, str]]] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    evaluations: list[tuple[list[float], list[float]]] = field(default_factory=list)


def read(text: str) -> Reading:
    """Import a log as it does, and open it."""
    reading = Reading()
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("SIM_TRACE_LOG"))
    for line in lines[:first]:
        _intro(line, reading)
    assert reading.actions, "no action space before the first step"
    assert all(float(reading.hyperparameters[name]) >= 0 for name in NUMBERS)
    assert float(reading.hyperparameters["discount_factor"]) > 0

    rewards: list[float] = []
    open_steps: list[dict[str, str]] = []
    early = 0
    for line in lines[first:]:
        if line.startswith("SIM_TRACE_LOG"):
            step = _step(line, reading)
            assert int(step["episode"]) <= len(reading.episodes), "an episode is missing"
            assert int(step["episode"]) == len(reading.episodes), "an episode comes twice"
            early += int(step["step"]) != len(open_steps) + 1
            assert early < EARLY_LINES, "steps are missing"
            open_steps.append(step)
            if step["done"] == "True":
                assert step["status"] in ENDS
                assert 100 / float(step["progress"])  # a forecast of the lap time
                reading.episodes.append(open_steps)
                open_steps = []
        elif line.startswith(REWARD):
            rewards.append(float(line.removeprefix(REWARD)))
        elif line.startswith(PROGRESS):
            count, _, rest = line.removeprefix(PROGRESS).partition(" ")
            progress = [float(number) for number in rest[:-1].split("[")[1].split(",")]
            assert int(count) == len(progress) == len(rewards)
            reading.evaluations.append((rewards, progress))
            rewards = []
            new = len(reading.episodes) - len(reading.iterations)
            reading.iterations += [len(reading.evaluations) - 1] * new
    rest = len(reading.episodes) - len(reading.iterations)
    reading.iterations += [len(reading.evaluations)] * rest
    assert reading.episodes, "no episode is whole"
    return reading


def _intro(line: str, reading: Reading) -> None:
    start = "[s3] Successfully downloaded yaml file from s3 key"
    if line.startswith(start) and not reading.model:
        name, _, file = line.removeprefix(start).partition("/")
        reading.model = name.strip() if file.startswith("training_params.yaml") else ""
    if line.startswith(" * /"):
        name, _, value = line.removeprefix(" * /").partition(": ")
        reading.parameters[name] = value
    if line.startswith('  "'):
        name, _, value = line.strip().removesuffix(",").partition(": ")
        reading.hyperparameters[name.strip('"')] = value
    if line.startswith("Sensor list [") and "action_space_type continuous" in line:
        reading.continuous = True
    if line.startswith(ACTIONS):
        reading.actions = json.loads(line.removeprefix(ACTIONS).replace("'", '"'))
        if reading.continuous:
            assert set(reading.actions) == {"speed", "steering_angle"}
        else:
            for index, action in enumerate(reading.actions):
                assert action.get("index", index) == index
                assert float(action["speed"]) > 0
                assert -90 < float(action["steering_angle"]) < 90


def _step(line: str, reading: Reading) -> dict[str, str]:
    names = (
        "episode step x y heading steering speed action reward done on_track progress waypoint "
        "track_length time status"
    )
    values = line.removeprefix("SIM_TRACE_LOG:").split(",")
    assert len(values) == 19
    step = dict(zip(names.split(), values, strict=False))
    whole = ["episode", "step", "waypoint"]
    if reading.continuous:
        assert step["action"].startswith("[")
        assert step["action"].endswith("]")
    else:
        whole.append("action")
        assert 0 <= int(step["action"]) < len(reading.actions)
    for name in whole:
        int(step[name])
    for name in ("x", "y", "heading", "steering", "speed", "reward", "progress", "time"):
        float(step[name])
    assert step["done"] in ("True", "False")
    return step
