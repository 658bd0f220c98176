"""Every command that takes a model, on a model that DeepRacer-for-Cloud has trained.

Each works on it or names the one command that does, and none advises to delete it. The commands are
called once; a racer looks and drives first, and then trains on.
"""

import re
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import pytest

from drcli.cli.command_table import COMMANDS
from reference_model import BEST, LAST, NEWEST, reference_model

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]

DELETING = re.compile(
    r"\bdelete (it|them|that)|delete that|start over|\bwith `?-w|only damaged", re.I
)
"""Advice that would cost the racer the model."""


@dataclass(frozen=True)
class Call:
    """A command line, without `dr`, and a piece of what it must answer."""

    words: str
    says: str
    code: int = 0


LOOKING = [
    Call("list-models", "model (TensorFlow)"),
    Call("list-models --json", '"kind": "tensorflow"'),
    Call("list-checkpoints --check", "last, TensorFlow"),
    Call("status", "Nothing was started here yet."),
    Call("summary", NEWEST),
    Call("history", "There is no training"),
    Call("journal", "s3://bucket/model"),
    Call("logs trainer -a", "", 1),
    Call("url", "s3://bucket/model/"),
    Call("action-space from-histogram", "3 actions"),
    Call("note add words", "words"),
    Call("support-bundle bundle.tar.gz --without-files", "none is in the archive"),
    Call("doctor", "s3://bucket"),
    Call("validate", "Continue that training with `dr-start-training --resume`"),
    Call("start-training -q", "Continue that training with `dr-start-training --resume`", 3),
    Call("start-worker --join s3://bucket/model", "is not being trained.", 3),
    Call("stop-training", "No training is running."),
    Call("delete-model model --dry-run", "model"),
    Call("tidy --dry-run", ""),
    Call("export car", "Same action as the weights in 200 of 200 frames"),
    Call("upload-car-zip -f -L", LAST),
    Call("upload-model -f -L", LAST),
    Call("download-model -s s3://bucket/model -t copy -f -L", "Downloaded"),
    Call("import -L s3://bucket/model -t imported -f --no-drive", "imported"),
]

DRIVING = [
    Call("start-evaluation --checkpoint best", BEST),
    Call("evaluate --models model --worlds reinvent_base", "model"),
    Call("analyze", "Verdict:"),
    Call("start-loganalysis --no-open", "model"),
    Call("url-loganalysis", "model"),
    Call("video --gif", "Video of"),
    Call("saliency -n 1 --spacing 20", f"checkpoint {LAST}"),
    Call("race create Cup --laps 1", "Cup"),
    Call("race submit cup --racer Ann", "Submitted checkpoint"),
    Call("race run cup -n 1 --no-video", "Ann"),
]

TRAINING = [
    Call("start-training --resume --foreground --max-minutes 0.05", f"resuming from {NEWEST}"),
    Call("list-models model --json", '"kind": "drcli"'),
    Call("increment-training -f", "model-1"),
]

CALLS = [*LOOKING, *DRIVING, *TRAINING]

OTHERS = {
    *("stop-all", "stop-evaluation", "stop-viewer", "stop-metrics", "stop-loganalysis"),
    *("logs-loganalysis", "logs-sagemaker", "logs-robomaker", "find-sagemaker", "find-robomaker"),
    *("get-robomaker-stats", "console", "start-viewer", "update-viewer", "view-stream"),
    *("send-message", "start-metrics", "sweep", "spot", "start-tournament", "car"),
    *("increment-upload-model", "set-upload-model", "list-aws-models"),
    *("droa-login", "droa-logout", "droa-list-models", "droa-get-model", "droa-import-model"),
    *("droa-download-logs", "droa-delete-model", "init", "config", "bench"),
    *("upload-custom-files", "download-custom-files", "update", "update-env", "reload", "explain"),
    *(
        "attach",
        "docs",
        "local-aws",
        "completion",
        "shell-env",
        "tracks",
        "reward",
        "help",
        "version",
        "droa",
        "metrics",
    ),
}
"""They take no model of the bucket, or only what runs at the moment, or need Amazon or a car."""


@pytest.fixture(scope="module")
def answers(shared_workspace: Any) -> Iterator[dict[Call, "subprocess.CompletedProcess[str]"]]:
    """All calls, and what they answered; afterwards, what the reference wrote is still there."""
    space = shared_workspace
    for file in (space.folder / "custom_files").iterdir():
        file.unlink()
    files = reference_model()
    for name, data in files.items():
        path = space.model / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    space.write_run_env(DR_EVAL_NUMBER_OF_TRIALS=1, DR_UPLOAD_S3_PREFIX="upload")
    found: dict[Call, subprocess.CompletedProcess[str]] = {}

    def in_turn(calls: Sequence[Call]) -> None:
        for call in calls:
            found[call] = space.run(*call.words.split())

    with ThreadPoolExecutor(2) as pool:
        for running in [pool.submit(in_turn, calls) for calls in (LOOKING, DRIVING)]:
            running.result()
    in_turn(TRAINING)
    yield found
    lost = [
        name
        for name, data in files.items()
        if re.search(r"\.pb$|\.ckpt\.|simtrace|ip/", name)
        and (space.model / name).read_bytes() != data
    ]
    assert not lost


def test_every_command_is_called_or_takes_no_model():
    called = {call.words.split()[0] for call in CALLS}

    assert called | OTHERS == {command.name for command in COMMANDS}
    assert not called & OTHERS


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.words)
def test_a_command_works_on_a_model_of_deepracer_for_cloud_or_names_the_one_that_does(
    answers, call
):
    answer = answers[call]

    told = answer.stdout + answer.stderr
    assert answer.returncode == call.code, told
    assert call.says in told
    assert "Traceback" not in told
    assert not DELETING.search(told), told
