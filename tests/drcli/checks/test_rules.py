"""Every rule on a folder that keeps it, and on one that breaks it."""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from drcli.base.errors import DrError, ProblemsError, SettingsError, StorageError
from drcli.bucket.bucket import TEST_FOLDER, ObjectInfo
from drcli.config.loading import load_settings
from drcli.convert.reference_checkpoint import refuse_other_networks
from drcli.learn.policy import PolicySpec
from drcli.model import lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import run_folder
from drcli.records.training_record import DaySpending, day_of, write_day
from drcli.run.plan import StartOptions, prepare
from minio_files import put
from own_run import own_run

Spoil = Callable[[Any], object]
"""Changes a folder."""

SAC = {
    "training_algorithm": "sac",
    "action_space_type": "continuous",
    "action_space": {
        "steering_angle": {"low": -20, "high": 20},
        "speed": {"low": 1.0, "high": 2.0},
    },
}


def ranges(steering: tuple[float, float], speed: tuple[float, float]) -> dict[str, object]:
    """Continuous actions of model_metadata.json."""
    limits = {"steering_angle": steering, "speed": speed}
    space = {key: {"low": low, "high": high} for key, (low, high) in limits.items()}
    return {"action_space_type": "continuous", "action_space": space}


def action(steering: float, speed: float = 1, **more: object) -> dict[str, object]:
    """An action of a list of them."""
    return {"steering_angle": steering, "speed": speed, **more}


def obstacles(positions: str) -> dict[str, object]:
    """Settings for obstacles in these places."""
    return {"DR_RACE_TYPE": "OBJECT_AVOIDANCE", "DR_OA_OBJECT_POSITIONS": positions}


def reward(*lines: str) -> str:
    """A reward function whose body is these lines."""
    return "def reward_function(params):\n" + "".join(f"    {line}\n" for line in lines)


def own(path: Path, text: str, mode: int) -> Path:
    """A file with a mode."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n")
    path.chmod(mode)
    return path


@dataclass(frozen=True)
class Case:
    """A rule, a folder that just keeps it, one that breaks it, and what is said then.

    Attributes:
        rule: Its number.
        keep: Makes a folder that keeps it.
        spoil: Makes one that breaks it.
        severity: Of the breach.
        words: Stand in its place, message or remedy.
        console: Whether the console shall take the model.
    """

    rule: str
    keep: Spoil
    spoil: Spoil
    severity: str
    words: tuple[str, ...]
    console: bool = False


CASES = (
    Case(
        "V-01",
        lambda f: f.settings(DR_LOCAL_S3_MODEL_PREFIX="team/my-model-1"),
        lambda f: f.settings(DR_LOCAL_S3_MODEL_PREFIX="team/my_model"),
        "warning",
        ("run.env line 2", "my_model", "letters, digits and hyphens"),
    ),
    Case(
        "V-02",
        lambda f: f.reward(reward("return 1.0")),
        lambda f: f.reward(reward("return 1 +")),
        "error",
        ("custom_files/reward_function.py line 2", "not valid Python", "return 1 +"),
    ),
    Case(
        "V-02",
        lambda f: f.reward("import math\n" + reward("return math.pi")),
        lambda f: f.reward("import nonsense_module\n" + reward("return 1.0")),
        "error",
        ("reward_function.py line 1", "nonsense_module"),
    ),
    Case(
        "V-02",
        lambda f: None,
        lambda f: f.remove("reward_function.py"),
        "error",
        ("custom_files", "reward_function.py is missing", "an example is"),
    ),
    Case(
        "V-03",
        lambda f: f.metadata(),
        lambda f: f.write("model_metadata.json", ""),
        "error",
        ("custom_files/model_metadata.json", "is empty"),
    ),
    Case(
        "V-03",
        lambda f: f.metadata(sensor=["LEFT_CAMERA"]),
        lambda f: f.metadata(sensors=["LEFT_CAMERA"]),
        "error",
        ("sensors", "Did you mean sensor?"),
    ),
    Case(
        "V-04",
        lambda f: f.hyperparameters(),
        lambda f: f.write("hyperparameters.json", "{"),
        "error",
        ("custom_files/hyperparameters.json line 1", "not valid JSON"),
    ),
    Case(
        "V-04",
        lambda f: f.hyperparameters(batch_size=64),
        lambda f: f.hyperparameters(bach_size=64),
        "warning",
        ("line 2", "bach_size=64", "Did you mean batch_size?"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_WORLD_NAME="reinvent_base"),
        lambda f: f.settings(DR_WORLD_NAME="reinvent_bas"),
        "error",
        ("run.env line 1", "DR_WORLD_NAME=reinvent_bas", "reinvent_base"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_WORLD_NAME="reinvent_base_cw"),
        lambda f: f.settings(DR_WORLD_NAME="reInvent2019_track"),
        "error",
        ("run.env line 1", "a community track", "`dr-tracks fetch reInvent2019_track`"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_TRAIN_EVAL_WORLD="bean"),
        lambda f: f.settings(DR_TRAIN_EVAL_WORLD="LGSWide"),
        "error",
        ("run.env line 3", "DR_TRAIN_EVAL_WORLD: LGSWide is a community track"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_TRACKS_FETCH="always"),
        lambda f: f.settings(DR_TRACKS_FETCH="always", DR_TRAIN_EVAL_WORLD="LGSWide"),
        "note",
        ("run.env line 4", "DR_TRAIN_EVAL_WORLD: LGSWide is a community track"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_TRAIN_WORLDS="bean, zoo:2", DR_TRAIN_EVAL_WORLD="zoo:7-8"),
        lambda f: f.settings(DR_TRAIN_WORLDS="bean, zoo:2", DR_TRAIN_EVAL_WORLD="zoo:1-8"),
        "warning",
        ("run.env line 4", "DR_TRAIN_EVAL_WORLD: zoo-1 is trained too", "Leave it out"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_TRAIN_WORLDS="reinvent*"),
        lambda f: f.settings(DR_TRAIN_WORLDS="reinvent* bowti*"),
        "error",
        ("run.env line 3", "no installed track fits bowti*", "`dr-tracks fetch Bowtie_track`"),
    ),
    Case(
        "V-05",
        lambda f: f.settings(DR_TRAIN_WORLDS="zoo:3"),
        lambda f: f.settings(DR_TRAIN_WORLDS="zoo:many"),
        "error",
        ("run.env line 3", "DR_TRAIN_WORLDS: zoo:many does not name", "zoo:24 means zoo-0"),
    ),
    Case(
        "V-06",
        lambda f: f.settings(DR_HOST_X="False"),
        lambda f: f.settings(DR_HOST_X="True", DR_SAGEMAKER_CUDA_DEVICES="0"),
        "warning",
        ("run.env line 3", "DR_HOST_X=True", "needs no X server"),
    ),
    Case(
        "V-07",
        lambda f: f.settings(DR_RACE_TYPE="OBJECT_AVOIDANCE"),
        lambda f: f.settings(DR_RACE_TYPE="OBJECT_AVOIDENCE"),
        "error",
        ("run.env line 3", "DR_RACE_TYPE=OBJECT_AVOIDENCE", "Did you mean OBJECT_AVOIDANCE?"),
    ),
    Case(
        "V-07",
        lambda f: f.settings(DR_RACE_TYPE="HEAD_TO_BOT"),
        lambda f: f.settings(DR_RACE_TYPE="HEAD_TO_MODEL"),
        "error",
        ("run.env line 3", "evaluations only"),
    ),
    Case(
        "V-07",
        lambda f: f.settings(DR_RACE_TYPE="OBJECT_AVOIDANCE", DR_OA_NUMBER_OF_OBSTACLES=3),
        lambda f: f.settings(DR_RACE_TYPE="OBJECT_AVOIDANCE", DR_OA_NUMBER_OF_OBSTACLES=400),
        "error",
        ("run.env line 4", "DR_OA_NUMBER_OF_OBSTACLES"),
    ),
    Case(
        "V-07",
        lambda f: f.settings(**obstacles("0.25,1;0.5,-1")),
        lambda f: f.settings(**obstacles("0.25,1;0.25,-1")),
        "warning",
        ("run.env line 4", "nobody can pass the obstacles at 0.250 of the lap"),
    ),
    Case(
        "V-07",
        lambda f: f.settings(**obstacles("0,1;0.5,1")),
        lambda f: f.settings(**obstacles("0,1;1,1")),
        "warning",
        ("run.env line 4", "two obstacles stand in the same place, 1,1"),
    ),
    Case(
        "V-08",
        lambda f: f.settings(DR_CAR_COLOR="purple"),
        lambda f: f.settings(DR_CAR_COLOR="Pink"),
        "warning",
        ("run.env line 3", "DR_CAR_COLOR=Pink", "Purple"),
    ),
    Case(
        "V-09",
        lambda f: f.bucket.put("model-10/reward_function.py", b""),
        lambda f: f.bucket.put("model-1/reward_function.py", b""),
        "note",
        ("s3://bucket/model-1 exists. It holds files, but no checkpoint.", "Choose another"),
    ),
    Case(
        "V-10",
        lambda f: (f.train("old"), pretrain(f, "old")),
        lambda f: (f.train("old"), pretrain(f, "ol")),
        "error",
        ("DR_LOCAL_S3_PRETRAINED_PREFIX=ol", "no checkpoint at s3://bucket/ol/model/"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_IMPORT_MODEL_ON_COMPLETION="False"),
        lambda f: f.settings(DR_IMPORT_MODEL_ON_COMPLETION="True"),
        "warning",
        ("run.env line 3", "DR_DROA_URL is empty, so the model will not be imported"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_EVAL_MAX_RESETS=3),
        lambda f: f.settings(DR_EVAL_MAX_RESETS="many"),
        "error",
        ("run.env line 3", "DR_EVAL_MAX_RESETS=many", "Set DR_EVAL_MAX_RESETS to a whole number"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=20),
        lambda f: f.settings(DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=200),
        "warning",
        ("DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=200 is above 100",),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_WORKERS=1),
        lambda f: f.settings(DR_WORKER=1),
        "error",
        ("run.env line 3", "DR_WORKER=1", "Did you mean DR_WORKERS?"),
    ),
    Case(
        "V-50",
        lambda f: own(f.path / "system.env", "DR_WEBHOOK_URL=https://x.com/hook", 0o600),
        lambda f: own(f.path / "system.env", "DR_WEBHOOK_URL=https://x.com/hook", 0o644),
        "warning",
        ("system.env", "(mode 644), and it contains DR_WEBHOOK_URL", "`chmod go= "),
    ),
    Case(
        "V-50",
        lambda f: own(f.path / "run.env", "DR_WORLD_NAME=bean", 0o644),
        lambda f: own(f.path / "system.env.bak", "export DR_CAR_PASSWORD=x", 0o640),
        "warning",
        ("system.env.bak", "(mode 640), and it contains DR_CAR_PASSWORD", "`chmod go= "),
    ),
    Case(
        "V-50",
        lambda f: own(f.path / "data/s3/bucket/object", "", 0o644).parents[1].chmod(0o700),
        lambda f: own(f.path / "data/s3/bucket/object", "", 0o600).parents[1].chmod(0o750),
        "warning",
        ("data/s3", "(mode 750), and it contains the models of the bucket", "`chmod go= "),
    ),
    Case(
        "V-50",
        lambda f: own(f.path / "data/s3/object", "", 0o640).parent.chmod(0o2750),
        lambda f: own(f.path / "data/logs/sim-0.log", "", 0o600).parent.chmod(0o755),
        "warning",
        ("data/logs", "(mode 755), and it contains the logs", "`chmod go= "),
    ),
    Case(
        "V-13",
        lambda f: lease.take(ModelStore(f.bucket, "model-2"), "abc"),
        lambda f: lease.take(ModelStore(f.bucket, "model-1"), "abc"),
        "error",
        ("s3://bucket/model-1", "is being trained by process"),
    ),
    Case(
        "V-13",
        lambda f: own_run().write(run_folder(f.path, 1)),
        lambda f: own_run().write(run_folder(f.path, 0)),
        "error",
        ("Run 0 is training s3://bucket/model-1", "dr-stop-training"),
    ),
    Case(
        "V-14",
        lambda f: own(f.path / "bin/activate.sh", "echo mine", 0o600),
        lambda f: own(f.path / "bin/activate.sh", "source bin/scripts_wrapper.sh", 0o600),
        "warning",
        ("bin/activate.sh", "its functions win over the programs", "`dr-init --adopt`"),
    ),
    Case(
        "V-15",
        lambda f: put(f.path / "data/minio/other/old/model/.coach_checkpoint", b"a"),
        lambda f: put(f.path / "data/minio/bucket/old/model/.coach_checkpoint", b"a"),
        "warning",
        ("old lies in data/minio/bucket", "`dr-import data/minio/bucket/old -t old`"),
    ),
    Case(
        "V-12",
        lambda f: spend(f, 1.0),
        lambda f: spend(f, 3.0),
        "error",
        ("run.env line 3", "3.00 machine hours", "next day"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_LAUNCHER="local", DR_RAY_TRAINER="gpu"),
        lambda f: f.settings(DR_LAUNCHER="ray", DR_RAY_TRAINER="gpu"),
        "error",
        ("run.env line", "Ray"),
    ),
    Case(
        "V-50",
        lambda f: (f.path / "data" / "logs").mkdir(parents=True),
        lambda f: (f.path / "data").write_text(""),
        "error",
        ("logs cannot be written there",),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_INTERRUPTION_COMMAND="\"sh -c 'wait'\""),
        lambda f: f.settings(DR_INTERRUPTION_COMMAND='"sh -c \'wait"'),
        "error",
        ("run.env line 3", "No closing quotation", "Close every quotation mark"),
    ),
    Case(
        "V-20",
        lambda f: f.reward(reward("return 1e5")),
        lambda f: f.reward(reward("return 'fast'")),
        "error",
        ("reward_function.py line 1", "returned 'fast'", "not a number"),
    ),
    Case(
        "V-20",
        lambda f: f.reward(reward("return -1e5")),
        lambda f: f.reward(reward("return float('inf')")),
        "error",
        ("returned inf",),
    ),
    Case(
        "V-20",
        lambda f: f.reward("import numpy\n" + reward("return numpy.float64(1.0)")),
        lambda f: f.reward(reward("return params['all_wheels_on_track']")),
        "warning",
        ("bool", "return float(reward)"),
    ),
    Case(
        "V-20",
        lambda f: f.reward(reward("return 1.0")),
        lambda f: f.reward("def reward_function(params, more):\n    return 1.0\n"),
        "error",
        ("line 1", "exactly one argument"),
    ),
    Case(
        "V-20",
        lambda f: f.reward(reward("return 1.0")),
        lambda f: f.reward("def reward_function(params, more=1):\n    return 1.0\n"),
        "error",
        ("line 1", "reward_function(params, more=1)"),
        console=True,
    ),
    Case(
        "V-21",
        lambda f: f.reward(reward("return 1.0 / (1.0 + params['progress'])")),
        lambda f: f.reward(reward("return 1.0 / (params['steps'] - 2)")),
        "error",
        ("line 2", "failed on the start line (step 2", "ZeroDivisionError", "return 1.0 / (params"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("if params['speed'] > 90:", "    return 2.0", "return 1.0")),
        lambda f: f.reward(reward("if params['speed'] > 90:", "    return bonus", "return 1.0")),
        "warning",
        ("line 3", "undefined name 'bonus'"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("if params['speed'] > 90:", "    return 2.0", "return 1.0")),
        lambda f: f.reward(reward("if params['speed'] > 90:", "    return bonus", "return 1.0")),
        "error",
        ("line 3", "undefined name 'bonus'"),
        console=True,
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("if params['steps'] > 9:", "    return 2.0", "return 1.0")),
        lambda f: f.reward(reward("if params['steps'] > 9:", "    return bonus", "return 1.0")),
        "error",
        ("line 3", "NameError: name 'bonus'"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("return 1.0  # noqa")),
        lambda f: f.reward("import math\n\n\n" + reward("return 1.0")),
        "warning",
        ("line 1", "'math' imported but unused"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("x = [1, 2]", "return 1.0 + x[0]*2" + " " * 90)),
        lambda f: f.reward(reward("x = [1,2]", "y = [3,4]", "return 1.0 + x[0] + y[0]")),
        "warning",
        ("line 2", "E231", "also in line 3"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("x = (1, 2)", "return 1.0 + x[0]")),
        lambda f: f.reward(reward("x = (1,  2)", "return 1.0 + x[0]")),
        "warning",
        ("line 2", "E241 multiple spaces"),
    ),
    Case(
        "V-22",
        lambda f: f.reward(reward("if params['speed'] > 90:", "    return 2.0", "return 1.0")),
        lambda f: f.reward(reward("if params['speed'] > 90: return 2.0", "return 1.0")),
        "warning",
        ("line 2", "E701", "Correct it, or end the line with `# noqa`."),
    ),
    Case(
        "V-22",
        lambda f: f.reward("import math\n\n\n" + reward("return math.pi")),
        lambda f: f.reward(reward("import math", "return math.pi")),
        "error",
        ("line 2", "import math", "top of the file"),
        console=True,
    ),
    Case(
        "V-23",
        lambda f: f.reward(
            "import numpy.linalg as la\n\n\n" + reward("return float(la.norm([1]))")
        ),
        lambda f: f.reward("import os\n\n\n" + reward("return float(os.getpid())")),
        "error",
        ("line 1", "imports os", "shapely"),
        console=True,
    ),
    Case(
        "V-23",
        lambda f: f.reward("import random\n\n\n" + reward("return random.random()")),
        lambda f: f.reward(reward("return eval('1.0')")),
        "error",
        ("line 2", "uses eval"),
        console=True,
    ),
    Case(
        "V-24",
        lambda f: f.reward(reward("return 9.0 if params['progress'] == 100 else 1.0")),
        lambda f: f.reward(reward("return 9.0 if params['progress'] == 1 else 1.0")),
        "warning",
        ("line 2", "progress >= 100"),
    ),
    Case(
        "V-24",
        lambda f: f.reward(reward("return 9.0 if params['steps'] <= 2 else 1.0")),
        lambda f: f.reward(reward("return 9.0 if params['steps'] == 1 else 1.0")),
        "warning",
        ("line 2", "`params['steps'] == 1` is never true", "steps <= 2"),
    ),
    Case(
        "V-24",
        lambda f: f.reward(reward("if params['x'] > 1:", "    pass", "return 1.0")),
        lambda f: f.reward(reward("if params['x'] > 1:", "    pass", "else if True:", "    pass")),
        "error",
        ("line 4", "else if", "Write `elif`"),
    ),
    Case(
        "V-25",
        lambda f: f.reward(reward("return 1.0")),
        lambda f: f.reward(reward("open('log.txt', 'a').close()", "return 1.0")),
        "warning",
        ("line 2", "writes or removes files in every call: log.txt"),
    ),
    Case(
        "V-26",
        lambda f: f.reward("import time\n\n\n" + reward("return time.time() * 1e-9")),
        lambda f: f.reward("import time\n\n\n" + reward("time.sleep(1e-3)", "return 1.0")),
        "warning",
        ("line 4", "A call takes", "more than the simulation of the step itself"),
    ),
    Case(
        "V-30",
        lambda f: f.metadata(action_space=[{"steering_angle": 0, "speed": 1, "index": 0}]),
        lambda f: f.metadata(action_space=[action(n, index=n + 1) for n in range(6)]),
        "warning",
        ("6 of 6 actions whose index is not their position", "Nothing reads index"),
    ),
    Case(
        "V-30",
        lambda f: f.metadata(),
        lambda f: f.metadata(action_space=[{"steering_angle": 0, "speed": 1}] * 2),
        "warning",
        ("action 1 repeats action 0", "Remove one"),
    ),
    Case(
        "V-30",
        lambda f: f.metadata(action_space=[action(0, index=0), action(9, index=1)]),
        lambda f: f.metadata(action_space=[action(0, index=1), action(9, index=0)]),
        "warning",
        ("2 of 2 actions whose index is not their position", "remove the indices"),
    ),
    Case(
        "V-31",
        lambda f: f.metadata(**ranges((-20, 20), (1, 2))),
        lambda f: f.metadata(**ranges((20, -20), (1, 2))),
        "error",
        ("action_space.steering_angle", "low that is not below its high"),
    ),
    Case(
        "V-31",
        lambda f: f.metadata(**ranges((-10, 20), (1, 2))),
        lambda f: f.metadata(**ranges((-20, 10), (1, 2))),
        "warning",
        ("physical car", 'Write "high": 20'),
    ),
    Case(
        "V-32",
        lambda f: f.metadata(**ranges((-30, 30), (0.5, 4))),
        lambda f: f.metadata(**ranges((-30, 30), (0.2, 4))),
        "warning",
        ("action_space.speed from 0.2 to 4", "0.5 to 4"),
    ),
    Case(
        "V-32",
        lambda f: f.metadata(),
        lambda f: f.metadata(action_space=[{"steering_angle": a, "speed": 1} for a in (0, 31)]),
        "warning",
        ("action_space[1].steering_angle=31", "-30 to 30"),
    ),
    Case(
        "V-32",
        lambda f: f.metadata(action_space=[action(30, speed=4), action(-30, speed=0.1)]),
        lambda f: f.metadata(action_space=[action(30, speed=4), action(-30, speed=4.1)]),
        "error",
        ("action_space[1].speed=4.1", "0.1 to 4"),
        console=True,
    ),
    Case(
        "V-32",
        lambda f: f.metadata(action_space=[action(n) for n in range(30)]),
        lambda f: f.metadata(action_space=[action(n - 15) for n in range(31)]),
        "error",
        ("31 actions learn slowly", "Keep at most 30"),
        console=True,
    ),
    Case(
        "V-33",
        lambda f: f.metadata(sensor=["STEREO_CAMERAS", "LIDAR"]),
        lambda f: f.metadata(sensor=["STEREO_CAMERAS", "FRONT_FACING_CAMERA"]),
        "error",
        ("sensor", "more than one camera"),
    ),
    Case(
        "V-33",
        lambda f: f.metadata(sensor=["LEFT_CAMERA", "SECTOR_LIDAR"]),
        lambda f: f.metadata(sensor=["LEFT_CAMERA", "DISCRETIZED_SECTOR_LIDAR"]),
        "warning",
        ("DISCRETIZED_SECTOR_LIDAR", "physical car"),
    ),
    Case(
        "V-34",
        lambda f: sac(f),
        lambda f: f.metadata(training_algorithm="sac"),
        "error",
        ("training_algorithm", "needs continuous actions"),
    ),
    Case(
        "V-34",
        lambda f: sac(f),
        lambda f: sac(f, exploration_type="e-greedy"),
        "error",
        ("exploration_type=e-greedy",),
    ),
    Case(
        "V-34",
        lambda f: sac(f),
        lambda f: sac(f, num_episodes_between_training=20),
        "warning",
        ("num_episodes_between_training=20", "it works here", "accept only 1"),
    ),
    Case(
        "V-35",
        lambda f: (f.train("old"), pretrain(f, "old")),
        lambda f: (
            f.train("old", action_space=[{"steering_angle": 0, "speed": 1}]),
            pretrain(f, "old"),
        ),
        "error",
        ("s3://bucket/old was trained with 1 discrete action,", "start a new model"),
    ),
    Case(
        "V-36",
        lambda f: f.metadata(neural_network="DEEP_CONVOLUTIONAL_NETWORK"),
        lambda f: f.metadata(neural_network="DEEP_NETWORK"),
        "error",
        ("neural_network", "DEEP_CONVOLUTIONAL_NETWORK"),
    ),
    Case(
        "V-40",
        lambda f: f.hyperparameters(batch_size=512),
        lambda f: f.hyperparameters(batch_size=34),
        "warning",
        ("line 2", "batch_size=34", "Write 32."),
    ),
    Case(
        "V-41",
        lambda f: f.hyperparameters(lr=1e-3, num_epochs=3, discount_factor=0.5),
        lambda f: f.hyperparameters(lr=1.5),
        "error",
        ("line 2", "lr=1.5", "above 1"),
    ),
    Case(
        "V-41",
        lambda f: f.hyperparameters(lr=1e-3, num_episodes_between_training=100),
        lambda f: f.hyperparameters(num_episodes_between_training=200),
        "error",
        ("num_episodes_between_training=200", "above 100"),
        console=True,
    ),
    Case(
        "V-41",
        lambda f: f.hyperparameters(discount_factor=0.5),
        lambda f: f.hyperparameters(discount_factor=0),
        "warning",
        ("discount_factor=0 plans less than two steps", "Write 0.9 to 0.999."),
    ),
    Case(
        "V-41",
        lambda f: f.hyperparameters(lr=1e-3),
        lambda f: f.hyperparameters(lr=1e-2),
        "warning",
        ("lr=0.01", "above 0.001"),
    ),
    Case(
        "V-41",
        lambda f: sac(f, num_episodes_between_training=1, num_epochs=1),
        lambda f: f.hyperparameters(num_episodes_between_training=1),
        "warning",
        ("num_episodes_between_training=1 gives the trainer little", "Write 20."),
    ),
    Case(
        "V-42",
        lambda f: (f.settings(DR_WORKERS=2), f.hyperparameters(num_episodes_between_training=40)),
        lambda f: (f.settings(DR_WORKERS=2), f.hyperparameters(num_episodes_between_training=20)),
        "warning",
        ("is 0.5 and not 1", "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=0.1", "training=40"),
        console=True,
    ),
    Case(
        "V-42",
        lambda f: (
            f.settings(DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST="0.0333333"),
            f.hyperparameters(num_episodes_between_training=30),
        ),
        lambda f: (
            f.settings(DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST="0.033"),
            f.hyperparameters(num_episodes_between_training=30),
        ),
        "warning",
        ("is 0.99 and not 1", "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=0.0333333."),
        console=True,
    ),
    Case(
        "V-43",
        lambda f: f.hyperparameters(loss_type="mean_squared_error"),
        lambda f: f.hyperparameters(loss_type="hubr"),
        "warning",
        ("loss_type", "Did you mean huber?"),
    ),
    Case(
        "V-44",
        lambda f: f.hyperparameters(term_cond_avg_score=350.0, term_cond_max_episodes=1000),
        lambda f: f.hyperparameters(term_cond_avg_score=500.0),
        "warning",
        ("term_cond_avg_score=500", "DR_TRAIN_STOP_MEAN_SCORE"),
    ),
    Case(
        "V-45",
        lambda f: (f.settings(DR_WORKERS=4), f.hyperparameters(num_episodes_between_training=20)),
        lambda f: (f.settings(DR_WORKERS=3), f.hyperparameters(num_episodes_between_training=20)),
        "warning",
        ("does not divide", "Write 18 or 21 episodes"),
    ),
    Case(
        "V-45",
        lambda f: (f.settings(DR_WORKERS=4), f.hyperparameters(num_episodes_between_training=100)),
        lambda f: (f.settings(DR_WORKERS=3), f.hyperparameters(num_episodes_between_training=100)),
        "warning",
        ("does not divide", "Write 99 episodes, or DR_WORKERS=1."),
    ),
    Case(
        "V-45",
        lambda f: (f.settings(DR_WORKERS=5), f.hyperparameters(num_episodes_between_training=5)),
        lambda f: (f.settings(DR_WORKERS=6), f.hyperparameters(num_episodes_between_training=5)),
        "error",
        ("run.env line 3", "DR_WORKERS=6 is more than", "DR_WORKERS to at most 5"),
    ),
    Case(
        "V-45",
        lambda f: (
            f.settings(DR_WORKERS=2, DR_TRAIN_MULTI_CONFIG=True),
            f.write("../worker-2.env", ""),
        ),
        lambda f: f.settings(DR_WORKERS=2, DR_TRAIN_MULTI_CONFIG=True),
        "error",
        ("worker-2.env", "no such file"),
    ),
    Case(
        "V-46",
        lambda f: f.hyperparameters(gae_lambda=1, e_greedy_value=0),
        lambda f: f.hyperparameters(gae_lambda=1.5),
        "error",
        ("gae_lambda=1.5", "above 1"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_REGULAR_UPLOAD=60, DR_UPLOAD_S3_BUCKET="models"),
        lambda f: f.settings(DR_REGULAR_UPLOAD=60),
        "warning",
        ("DR_REGULAR_UPLOAD asks for uploads", "DR_UPLOAD_S3_BUCKET"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_UPLOAD_S3_BUCKET="uploads"),
        lambda f: f.settings(DR_UPLOAD_S3_BUCKET="uploads/mine"),
        "warning",
        ("DR_UPLOAD_S3_BUCKET=uploads/mine is not the name of a bucket", "with mine/"),
    ),
    Case(
        "V-12",
        lambda f: f.settings(DR_UPLOAD_S3_BUCKET="uploads", DR_UPLOAD_BEST_MODEL="True"),
        lambda f: f.settings(DR_UPLOAD_S3_BUCKET="s3://uploads", DR_UPLOAD_BEST_MODEL="True"),
        "error",
        ("DR_UPLOAD_S3_BUCKET=s3://uploads is not the name of a bucket", "Write uploads."),
    ),
    Case(
        "V-50",
        lambda f: None,
        lambda f: setattr(f.bucket, "put", refuse_put),
        "error",
        ("The disk is full.", "Make room."),
    ),
    Case(
        "V-50",
        lambda f: None,
        lambda f: setattr(f.bucket, "list", lambda folder: late(folder)),
        "warning",
        ("20 minutes ahead of", "timedatectl"),
    ),
)


def spend(folder, hours):
    """Train for so many hours today; the budget has two."""
    folder.settings(DR_DAILY_BUDGET_HOURS=2)
    write_day(folder.path, day_of(time.time()), "abc", DaySpending(hours))


def pretrain(folder, prefix):
    """Start from another model's weights."""
    folder.settings(DR_LOCAL_S3_PRETRAINED=True, DR_LOCAL_S3_PRETRAINED_PREFIX=prefix)


def sac(folder, **hyperparameters):
    """Train with sac as the reference wants it."""
    folder.metadata(**SAC)
    folder.hyperparameters(
        **{
            "num_episodes_between_training": 1,
            "exploration_type": "additive_noise",
            **hyperparameters,
        }
    )


IMPORTED = {"DR_DROA_URL": "https://deepracer.example.com"}
"""The model is imported into DeepRacer on AWS at the end of its training."""


def with_network(folder, *, sac_too=False, network="DEEP_CONVOLUTIONAL_NETWORK", stack_size=1):
    """A network of the reference, but for what is changed."""
    folder.metadata(neural_network=network, **(SAC if sac_too else {}))
    more = {"num_episodes_between_training": 1, "exploration_type": "additive_noise"}
    folder.hyperparameters(stack_size=stack_size, **(more if sac_too else {}))


def told_of_import(folder):
    return [item for item in folder.breaches("V-34") if "cannot be imported" in item.message]


@pytest.mark.parametrize("sac_too", [False, True])
@pytest.mark.parametrize(
    "network", ["DEEP_CONVOLUTIONAL_NETWORK_SHALLOW", "COMPACT_CONVOLUTIONAL_NETWORK"]
)
@pytest.mark.parametrize("stack_size", [1, 3])
def test_what_the_import_at_the_end_would_refuse_is_told_before_the_start(
    folder, sac_too, network, stack_size
):
    folder.settings(**IMPORTED)
    with_network(folder, sac_too=sac_too, network=network, stack_size=stack_size)
    spec = PolicySpec(3, continuous=sac_too, network=network, stack=stack_size)
    try:
        refuse_other_networks(spec, is_sac=sac_too)
        refused = False
    except SettingsError:
        refused = True

    told = told_of_import(folder)

    assert bool(told) == refused
    assert {item.severity for item in told} <= {"warning"}
    assert all("DR_IMPORT_MODEL_ON_COMPLETION=False" in item.remedy for item in told)
    assert all("`dr-export droa --distill`" in item.remedy for item in told)


@pytest.mark.parametrize("settings", [{}, {**IMPORTED, "DR_IMPORT_MODEL_ON_COMPLETION": False}])
def test_a_network_of_our_own_is_no_problem_without_an_import(folder, settings):
    folder.settings(**settings)
    with_network(folder, network="COMPACT_CONVOLUTIONAL_NETWORK", stack_size=3)

    assert told_of_import(folder) == []


def refuse_put(key, data):
    """A bucket without room."""
    raise StorageError("The disk is full.", remedy="Make room.")


class _Any(str):
    """A key that is every key."""

    def __eq__(self, other):
        return True

    __hash__ = str.__hash__


def late(folder):
    """A listing of a server whose clock is 20 minutes late; nothing lies where models go."""
    if TEST_FOLDER not in folder:
        return []
    return [ObjectInfo(_Any(), 5, "", datetime.now(UTC) - timedelta(minutes=20))]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.rule}-{case.severity}")
def test_a_folder_that_keeps_a_rule_is_not_told_about_it(folder, case):
    case.keep(folder)

    breaches = folder.breaches(case.rule, console=case.console)

    assert [item for item in breaches if item.severity == case.severity] == []


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.rule}-{case.severity}")
def test_a_folder_that_breaks_a_rule_is_told_where_and_what_to_do(folder, case):
    case.spoil(folder)

    breaches = folder.breaches(case.rule, console=case.console)

    told = [f"{item.where} {item.message} {item.remedy}" for item in breaches]
    assert case.severity in {item.severity for item in breaches}
    assert [text for text in told if all(word in text for word in case.words)], told


@pytest.mark.parametrize(
    "case",
    [case for case in CASES if case.severity != "note" and not case.console],
    ids=lambda case: f"{case.rule}-{case.severity}",
)
def test_a_start_stops_at_what_is_an_error_and_at_nothing_else(folder, case, monkeypatch):
    monkeypatch.setattr("drcli.run.plan.open_bucket", lambda *_, **__: folder.bucket)
    case.spoil(folder)
    ok = folder.report().ok

    try:
        prepare(load_settings(folder.path, environ={}), StartOptions())
        starts = True
    except DrError:
        starts = False

    assert starts == ok == (case.severity != "error")


def test_a_folder_whose_stages_hide_what_is_wrong_does_not_start_either(folder, monkeypatch):
    monkeypatch.setattr("drcli.run.plan.open_bucket", lambda *_, **__: folder.bucket)
    folder.settings(DR_CURRICULUM_FILE="stages.yaml", DR_RACE_TYPE="HEAD_TO_MODEL")
    folder.hyperparameters(lr=2)
    stages = "stages:\n- {name: one, hyperparameters: {lr: 0.001}, goal: {iterations: 3}, "
    stages += "settings: {DR_RACE_TYPE: TIME_TRIAL}}\n- {name: two, hyperparameters: {lr: 0.001}, "
    stages += "settings: {DR_RACE_TYPE: TIME_TRIAL}}\n"
    folder.write("../stages.yaml", stages)
    told = [error.rule for error in folder.report().errors]

    with pytest.raises(ProblemsError) as refusal:
        prepare(load_settings(folder.path, environ={}), StartOptions())

    assert told == [error.rule for error in refusal.value.errors] == ["V-41"]


def test_every_documented_rule_is_tried_here_but_those_that_have_tests_of_their_own():
    page = (Path(__file__).resolve().parents[3] / "docs" / "validation.md").read_text("utf-8")
    documented = set(re.findall(r"^\| (V-\d\d)", page, re.MULTILINE))

    assert documented - {case.rule for case in CASES} == {"V-11", "V-16", "V-27", "V-60"}
    assert {case.rule for case in CASES} <= documented
