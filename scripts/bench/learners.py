"""Measure the updates of one learner process against those of several with the same cores.

Both learn from the same rollout by turns, so that the ratio does not depend on what else the
machine does. Gradients of one minibatch are compared as well.
"""

import argparse
import statistics
import time
from dataclasses import replace

import numpy as np
import torch
from learn_runs import Work, become_like_a_worker
from machine import facts

from drcli.learn.compute import Compute, choose_compute
from drcli.learn.learner import Learner
from drcli.learn.rollout_buffer import Rollout
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.train.learner_group import Build, LearnerGroup, build_learner, learner_group
from drcli.workers.cores import cores


def main() -> None:
    """Print samples/s of both, their ratio, and how far their gradients differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--learners", type=int, default=2, help="processes of the several")
    parser.add_argument("--steps", type=int, default=1024, help="of the rollout")
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--precision", default="auto", choices=("auto", "fp32", "bf16"))
    parser.add_argument("--network", default="DEEP_CONVOLUTIONAL_NETWORK_SHALLOW")
    options = parser.parse_args()
    become_like_a_worker()
    threads = cores()
    work = Work.load({}, options.network, threads)
    change = {"batch_size": options.batch_size}
    metadata = ModelMetadata.from_bytes(work.files["model_metadata.json"])
    parameters = work.parameters.model_copy(update=change)
    rollout = made_up_rollout(options.steps, work.spec.num_actions)
    each = max(1, threads // options.learners)
    alone_in = choose_compute(options.precision, options.batch_size, threads)
    shared_in = choose_compute(options.precision, options.batch_size // options.learners, each)
    print(*(f"{name}: {value}" for name, value in facts().items()), sep="\n")
    print(f"{options.network}, {alone_in.number_format}, minibatches of {options.batch_size}")
    with learner_group(options.learners) as group:
        assert group is not None
        exact = parameters.model_copy(update={"batch_size": options.steps, "num_epochs": 1})
        floats = [replace(c, bf16=False) for c in (alone_in, shared_in)]
        torch.set_num_threads(threads)
        one = build_learner(metadata, exact, floats[0])
        two = _shared(group, metadata, exact, floats[1], one)
        _update(one, rollout, None)
        _update(two, rollout, group)
        pairs = zip(one.model.parameters(), two.model.parameters(), strict=True)
        grads = [(p.grad, q.grad) for p, q in pairs if p.grad is not None and q.grad is not None]
        largest = max(float((p - q).abs().max() / p.abs().max()) for p, q in grads)
        print(f"gradients differ by {largest:.1e} of the largest one of their tensor at most")
        one = build_learner(metadata, parameters, alone_in)
        two = _shared(group, metadata, parameters, shared_in, one)
        ratios = []
        samples = options.steps * parameters.num_epochs
        for number in range(options.pairs + 1):
            torch.set_num_threads(threads)
            alone_s = _update(one, rollout, None)
            torch.set_num_threads(each)
            shared_s = _update(two, rollout, group)
            if number:  # the first pair prepares everything
                ratios.append(alone_s / shared_s)
                print(
                    f"{samples / alone_s:8.0f} samples/s in one process, "
                    f"{samples / shared_s:8.0f} in {options.learners}: {ratios[-1]:.2f}"
                )
        print(
            f"ratio {statistics.median(ratios):.2f}, {min(ratios):.2f} to {max(ratios):.2f} "
            f"in {len(ratios)} pairs"
        )


def _shared(
    group: LearnerGroup,
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    compute: Compute,
    like: Learner,
) -> Learner:
    """The learner of the group, with the weights of another one."""
    group.tell(Build(metadata, parameters, compute))
    learner = build_learner(metadata, parameters, compute, group.gradients)
    learner.model.load_state_dict(like.model.state_dict())
    return learner


def _update(learner: Learner, rollout: Rollout, group: LearnerGroup | None) -> float:
    """Seconds of an update."""
    began = time.perf_counter()
    if group is not None:
        group.begin_update(learner, rollout, 1, 0)
    learner.update(rollout, 1)
    return time.perf_counter() - began


def made_up_rollout(steps: int, actions: int) -> Rollout:
    """One episode of noise."""
    draw = np.random.default_rng(1)
    return Rollout(
        frames=draw.integers(0, 256, (steps, 1, 120, 160), dtype=np.uint8),
        actions=draw.integers(0, actions, steps),
        log_probs=np.full(steps, -np.log(actions), np.float32),
        values=draw.normal(size=steps),
        rewards=draw.uniform(0.0, 1.0, steps),
        lengths=np.full(1, steps),
        last_values=np.zeros(1),
        cut=np.zeros(1, np.bool_),
        scans=np.zeros((steps, 0), np.float32),
        states=np.zeros((steps, 0), np.float32),
    )


if __name__ == "__main__":
    main()
