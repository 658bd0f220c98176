"""What a training does when reward function or learning fail."""

from typing import Literal

from drcli.config.fields import Group, setting


class FailureSettings(Group, title="Failures during a training"):
    reward_on_error: Literal["stop", "count"] = setting(
        "DR_REWARD_ON_ERROR",
        "count",
        "When the reward function fails: stop ends the training, count goes on and learns nothing "
        "from that step.",
    )
    reward_fallback: float = setting(
        "DR_REWARD_FALLBACK",
        0.001,
        "What traces and metrics show as the reward of a step whose call of the reward function "
        "failed; only with count.",
        between=(-100_000, 100_000),
    )
    reward_max_error_share: float = setting(
        "DR_REWARD_MAX_ERROR_SHARE",
        0.05,
        "With count, the training ends when more than this share of a worker's last 2,000 calls "
        "of the reward function failed.",
        between=(0, 1),
    )
    train_max_rollbacks: int = setting(
        "DR_TRAIN_MAX_ROLLBACKS",
        0,
        "How often a training goes back to its last good checkpoint, with a third of the learning "
        "rate, when the loss is NaN or the policy has collapsed; 0 never.",
        between=(0, 20),
    )
