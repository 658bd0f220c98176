"""Trainings of others in processes of their own, for `bench learn`.

A peer's module is a program: it begins its training, and for each line that comes on stdin drives
and learns once and answers with steps and seconds.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import torch
from learn_runs import Pace, Work
from torch import Tensor, nn

from drcli.learn.compute import flush_denormals
from drcli.learn.encoders import MONO, Encoder
from drcli.learn.policy import PolicySpec
from drcli.records.job import PROCESS_TUNING

STEPS = 1_024
"""Of an iteration, all cars together."""


class Training(Protocol):
    """One of the contestants."""

    def iterate(self) -> Pace:
        """Drive and learn once."""

    def close(self) -> None:
        """Let go of threads and processes."""


@dataclass(frozen=True)
class Choice:
    """How a peer runs.

    Attributes:
        cars: How many drive side by side.
        autocast: Whether its body computes in bfloat16, by torch.autocast.
    """

    cars: int
    autocast: bool = False

    def __str__(self) -> str:
        return f"{self.cars} cars, {'autocast to bf16' if self.autocast else 'fp32'}"


class Peer:
    """A training in another process, as its users would run it; it waits while others have turns.

    It has the same number of threads, but neither the memory settings and shorter spinning that
    our launcher gives to our workers, nor our way with numbers next to 0, unless they are lent.
    """

    def __init__(self, script: str, work: Work, choice: Choice, *, lend: bool) -> None:
        """Begin.

        Args:
            script: Name of the peer's module, in this folder.
            work: What to train.
            choice: How it runs.
            lend: Lend it the process settings of our workers.
        """
        environment = {k: v for k, v in os.environ.items() if PROCESS_TUNING.get(k) != v}
        arguments = {
            "environment": work.environment,
            "network": work.spec.network,
            "threads": work.threads,
            "precision": "bf16" if work.compute.bf16 else "fp32",
            "cars": choice.cars,
            "autocast": choice.autocast,
            "lend": lend,
        }
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).parent / script), json.dumps(arguments)],
            env=environment | PROCESS_TUNING if lend else environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def iterate(self) -> Pace:
        """Let it drive and learn once.

        Raises:
            RuntimeError: It has ended; the reason stands on stderr.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("iterate\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"A peer ended with exit code {self._process.wait()}.")
        steps, seconds = json.loads(answer)
        return Pace(steps, seconds)

    def close(self) -> None:
        """End its process."""
        self._process.communicate()


class Body(nn.Sequential):
    """Layers one after the other, in bfloat16 if `autocast` is set. Features are float32."""

    autocast = False

    def forward(self, frames: Tensor) -> Tensor:
        """Features, shape (n, features)."""
        with torch.autocast(frames.device.type, torch.bfloat16, enabled=self.autocast):
            features: Tensor = super().forward(frames)
        return features.float()


def plain_body(spec: PolicySpec, *, autocast: bool) -> tuple[Body, int]:
    """The layers of one of our bodies for one camera, put together as their users would.

    Returns:
        The body, with initial weights of PyTorch's, and how many features come out.
    """
    layers = MONO[spec.network]
    body = Body()
    body.autocast = autocast
    channels = spec.channels
    for filters, kernel, stride in layers.convolutions:
        body.append(nn.Conv2d(channels, filters, kernel, stride))
        body.append(nn.ReLU())
        channels = filters
    body.append(nn.Flatten())
    for ours in Encoder(spec).dense:
        assert isinstance(ours, nn.Linear)
        body.append(nn.Linear(ours.in_features, ours.out_features))
        body.append(nn.ReLU())
    return body, layers.dense[-1]


def serve(make: Callable[[Work, int, Choice], Training]) -> None:
    """The main function of a peer's process.

    Args:
        make: Makes the training from the work, the steps of an iteration, and how it runs.
    """
    arguments = json.loads(sys.argv[1])
    if arguments["lend"]:
        flush_denormals()
    work = Work.load(
        arguments["environment"] | {"DR_TORCH_PRECISION": arguments["precision"]},
        arguments["network"],
        arguments["threads"],
    )
    choice = Choice(arguments["cars"], arguments["autocast"])
    training = make(work, STEPS, choice)
    for _ in sys.stdin:
        print(json.dumps(training.iterate()), flush=True)
    training.close()
