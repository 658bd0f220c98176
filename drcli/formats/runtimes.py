"""Policies in PyTorch, our interpreter, onnxruntime, OpenVINO or LiteRT."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.base.errors import NotAvailable, SettingsError
from drcli.exchange.policy_source import Runtime
from drcli.formats.build_network import weights_of
from drcli.formats.engine_fit import Fit, fit, open_file
from drcli.formats.frozen_graph import encode_policy
from drcli.formats.policy_engines import RUNS, Engine, open_engine
from drcli.formats.policy_file import PolicyFile
from drcli.learn import distributions
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation, Policy, PolicySpec
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.model_metadata import ModelMetadata

_LEAST_PROBABILITY = 1e-30


class EnginePolicy:
    """A graph in an engine as a `Policy`.

    Discrete actions are drawn unless it only says the likeliest; of continuous ones it has the mean
    alone.
    """

    def __init__(self, engine: Engine, found: Fit, spec: PolicySpec, origin: str) -> None:
        self.spec = spec
        self._engine = engine
        self._fit = found
        self._origin = origin

    def outputs(self, frames: NDArray[np.uint8], scans: NDArray[np.float32]) -> NDArray[np.float32]:
        """Probabilities (1 for an index) or continuous actions, shape (n, num_actions).

        Args:
            frames: Shape (n, stack * eyes, 120, 160).
            scans: Shape (n, d).

        Raises:
            SettingsError: Outputs are not numbers.
        """
        values = self._fit.run(self._engine, frames, scans)
        if not np.isfinite(values).all():
            raise SettingsError(
                f"{self._origin} gives values that are not numbers.",
                remedy="Export it again from another checkpoint.",
            )
        if self._fit.meaning == "index":
            return self._certain(values[:, 0].astype(np.int64))
        if self._fit.meaning == "logits":
            powers = np.exp(values - values.max(axis=1, keepdims=True))
            values = powers / powers.sum(axis=1, keepdims=True)
        return values

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `Policy.act`; estimates and log-probabilities of continuous actions are 0.

        Raises:
            NotAvailable: Only the mean is known, so nothing can be drawn.
            SettingsError: Outputs are not numbers.
        """
        values = torch.from_numpy(self.outputs(seen.frames.numpy(), seen.scan.numpy()))
        nothing = torch.zeros(len(values), dtype=torch.float64)
        if self.spec.continuous:
            if not bool(deterministic.all()):
                raise self._only_the_best("mean of the actions")
            return values, nothing.float(), nothing
        best = values.argmax(-1)
        logits = values.clamp(min=_LEAST_PROBABILITY).log()
        if bool(deterministic.all()):
            drawn = best
        elif self._fit.meaning == "index":
            raise self._only_the_best("likeliest action")
        elif epsilon is None:
            drawn = distributions.sample_categorical(logits, noise[:, 0].contiguous())
        else:
            drawn = distributions.sample_e_greedy(logits, noise, epsilon)
        actions = torch.where(deterministic, best, drawn)
        return actions, distributions.log_prob_categorical(logits, actions), nothing

    def _certain(self, indices: NDArray[np.int64]) -> NDArray[np.float32]:
        count = self.spec.num_actions
        if indices.min() < 0 or indices.max() >= count:
            raise SettingsError(
                f"{self._origin} chooses action {indices.max()}, but its model_metadata.json has "
                f"only {count} actions from 0 on.",
                remedy="Name the model_metadata.json that the policy was trained with, with "
                "--metadata FILE.",
            )
        return np.eye(count, dtype=np.float32)[indices]

    def _only_the_best(self, what: str) -> NotAvailable:
        return NotAvailable(
            f"No actions can be drawn from {self._origin}: it only has the {what}.",
            remedy="Drive it in an evaluation, which takes those.",
        )


def policy_of_file(
    file: PolicyFile, runtime: Runtime | None = None, threads: int = 1
) -> EnginePolicy:
    """The policy in a file, by default in the engine of its form.

    Raises:
        SettingsError: It is damaged, does not fit, or that engine does not run it.
        NotAvailable: The engine is not installed.
    """
    runtime = runtime or RUNS[file.form][0]
    engine, found = open_file(file, runtime, threads)
    spec = _spec(file.metadata, found.stack)
    return EnginePolicy(engine, found, spec, file.origin)


def policy_of_model(
    model: ActorCritic | SACAgent,
    metadata: ModelMetadata,
    runtime: Runtime,
    origin: str,
    threads: int = 1,
) -> Policy:
    """The network itself, or its graph in an engine.

    Raises:
        NotAvailable: The engine or its converter is not installed.
    """
    if runtime == "torch":
        return model
    spec = model.spec
    graph = encode_policy(weights_of(model), spec, metadata.sensor)
    engine = open_engine("pb", graph, b"", runtime, origin, threads)
    found = fit(engine, metadata, origin, "model_metadata.json", spec.stack)
    return EnginePolicy(engine, found, _spec(metadata, spec.stack), origin)


def _spec(metadata: ModelMetadata, stack: int) -> PolicySpec:
    space = metadata.action_space
    return PolicySpec(
        num_actions=space.num_actions,
        continuous=space.continuous,
        network=metadata.neural_network,
        eyes=metadata.eyes,
        stack=stack,
        scan_dims=metadata.scan_dims,
    )
