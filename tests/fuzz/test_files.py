"""No damaged file ends in a traceback, a hang, or half of a change."""

import os
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import strategies as st

import damage
from drcli.config.settings import catalogue
from exploring import explore

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(0)]

SHARE = 0.35
"""Of the time of the long form, for all files together."""

NAMES = list(catalogue())

SETTINGS = (
    *("config show", "config check", "config show --json", "validate", "validate --json", "status"),
    *(
        "summary --json",
        "url",
        "start-training -q",
        "start-training -w -q",
        "evaluate -q",
        "reload",
    ),
    *("list-models", "list-aws-models", "upload-model -d", "upload-model -f", "shell-env"),
    *("increment-training -f", "increment-upload-model -f", "set-upload-model car-7", "stop-all"),
    *("config set DR_WORKERS=1", "upload-custom-files", "download-custom-files", "tracks list"),
    *("tracks show reinvent_base", "logs trainer -a", "stop-training", "droa-list-models"),
    *("car status", "reward check", "local-aws s3 ls", "import given/model.tar.gz -t new -d"),
    *("export pb -f --out policy.pb", "download-model -s s3://bucket/model -t new -f"),
    *("logs-sagemaker -w 0", "find-robomaker", "get-robomaker-stats", "start-training --resume -q"),
)
STARTS = (
    *("validate", "validate --json --console-compatible", "start-training -w -q", "config check"),
    *("start-training --resume -q", "upload-custom-files", "reward check", "evaluate -c -q"),
)


@dataclass(frozen=True)
class Target:
    """A file, the damage that it meets, and the commands that read it."""

    name: str
    damage: st.SearchStrategy[damage.Damage]
    commands: tuple[str, ...]


TARGETS = (
    Target("run.env", damage.settings_file(NAMES), SETTINGS),
    Target("system.env", damage.settings_file(NAMES), SETTINGS),
    Target(
        "worker-2.env",
        damage.settings_file(NAMES),
        ("config check", "validate", "start-training -w -q", "config show"),
    ),
    Target("custom_files/hyperparameters.json", damage.json_file, STARTS),
    Target("custom_files/model_metadata.json", damage.json_file, STARTS),
    Target(
        "custom_files/reward_function.py",
        damage.program,
        ("validate", "start-training -w -q", "reward check", "upload-custom-files"),
    ),
    Target(
        "given/oval.npy",
        damage.route,
        (
            "tracks add given/oval.npy --name mine",
            "tracks show given/oval.npy",
            "tracks show given/oval.npy --png given/oval.png",
            "config check",
        ),
    ),
    Target(
        "given/model.tar.gz",
        damage.archive,
        ("import given/model.tar.gz -t new -f --no-drive", "import given/model.tar.gz -t new -d"),
    ),
    Target(
        "given/model/model/1_Step-144.ckpt.safetensors",
        damage.any_bytes,
        ("import given/model -t new -f --no-drive",),
    ),
    *(
        Target(f"given/model/{name}", how, ("import given/model -t new -f --no-drive -c",))
        for name, how in {
            "model/model_metadata.json": damage.json_file,
            "model/deepracer_checkpoints.json": damage.json_file,
            "model/.coach_checkpoint": damage.text,
            "model/1_Step-144.ckpt.json": damage.json_file,
            "ip/hyperparameters.json": damage.json_file,
            "training_params.yaml": damage.text,
            "reward_function.py": damage.program,
        }.items()
    ),
    Target(
        "data/runs/0/run.json",
        damage.json_file,
        (
            "status",
            "status --json",
            "stop-training",
            "stop-all",
            "summary",
            "logs",
            "start-training",
        ),
    ),
    Target(
        "data/s3/.server.json",
        damage.json_file,
        ("status", "summary --json", "url", "list-models", "local-aws s3 ls"),
    ),
    Target(
        "data/logs/robomaker/model/sim-0.log",
        damage.text,
        ("logs sim-0 -a", "logs-robomaker", "get-robomaker-stats", "logs"),
    ),
)


def _runs_env(target: Target) -> bool:
    return target.name.endswith(".env")


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_any_damage_to_a_file(space, target):
    def check(example: Any) -> None:
        change, command = example
        space.restore()
        path = space.folder / target.name
        path.write_bytes(change(path.read_bytes()))
        space.call(command.split(), {"DR_TRACKS_DIR": "given"} if "tracks" in command else {})

    few = 3 if _runs_env(target) else 1
    explore(
        st.tuples(target.damage, st.sampled_from(target.commands)),
        check,
        few=few,
        share=SHARE / len(TARGETS),
    )


def _missing(path: Any) -> None:
    path.unlink()


def _a_folder(path: Any) -> None:
    path.unlink()
    path.mkdir()


def _a_loop(path: Any) -> None:
    path.unlink()
    path.symlink_to(path.name)


def _a_pipe(path: Any) -> None:
    path.unlink()
    os.mkfifo(path)


def _a_device(path: Any) -> None:
    path.unlink()
    path.symlink_to("/dev/null")


def _unreadable(path: Any) -> None:
    path.chmod(0)


PLACES = (_missing, _a_folder, _a_loop, _a_pipe, _a_device, _unreadable)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_a_file_that_is_no_file(space, target):
    def check(example: Any) -> None:
        instead, command = example
        space.restore()
        instead(space.folder / target.name)
        space.call(command.split(), {"DR_TRACKS_DIR": "given"} if "tracks" in command else {})

    explore(
        st.tuples(st.sampled_from(PLACES), st.sampled_from(target.commands)),
        check,
        few=1,
        share=0.1 / len(TARGETS),
    )
