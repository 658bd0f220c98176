"""A rollout of noise, for tests of learners."""

import numpy as np

from drcli.learn.rollout_buffer import Rollout


def made_up_rollout(steps, actions, seed=0, *, continuous=False):
    """Four episodes of noise, with actions that were all equally likely, or continuous ones."""
    draw = np.random.default_rng(seed)
    taken = draw.integers(0, actions, steps)
    if continuous:
        taken = draw.uniform(-1.0, 1.0, (steps, 2)).astype(np.float32)
    return Rollout(
        frames=draw.integers(0, 256, (steps, 1, 120, 160), dtype=np.uint8),
        actions=taken,
        log_probs=np.full(steps, -np.log(actions), np.float32),
        values=draw.normal(size=steps),
        rewards=draw.uniform(0.0, 1.0, steps),
        lengths=np.full(4, steps // 4),
        last_values=np.zeros(4),
        cut=np.zeros(4, np.bool_),
        scans=np.zeros((steps, 0), np.float32),
        states=np.zeros((steps, 0), np.float32),
    )
