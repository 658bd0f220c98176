"""What an update reports, and the names under which CleanRL logs it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PPOStats:
    """Means over the minibatches of one epoch.

    `approx_kl` is the divergence from the policy that drove, `clip_fraction` the share of steps
    whose ratio left the clip range, and `explained_variance` that of the returns by the values
    of the time of driving: 1 is a perfect critic, 0 one that always says the mean.
    """

    epoch: int
    learning_rate: float
    explained_variance: float
    policy_loss: float
    value_loss: float
    entropy: float
    approx_kl: float
    clip_fraction: float

    def metrics(self) -> dict[str, float]:
        """The numbers by the names that CleanRL gives them."""
        return {
            "charts/learning_rate": self.learning_rate,
            "losses/value_loss": self.value_loss,
            "losses/policy_loss": self.policy_loss,
            "losses/entropy": self.entropy,
            "losses/approx_kl": self.approx_kl,
            "losses/clipfrac": self.clip_fraction,
            "losses/explained_variance": self.explained_variance,
        }


@dataclass(frozen=True)
class SACStats:
    """Means over a part of an update.

    `qf1_value` and `qf2_value` are what the critics expect of the steps learned from, `alpha` is
    the temperature, and `alpha_loss` is NaN where the temperature is fixed.
    """

    epoch: int
    learning_rate: float
    actor_loss: float
    qf1_loss: float
    qf2_loss: float
    qf1_value: float
    qf2_value: float
    entropy: float
    alpha: float
    alpha_loss: float

    @property
    def critic_loss(self) -> float:
        """Mean of both critics' losses."""
        return (self.qf1_loss + self.qf2_loss) / 2.0

    def metrics(self) -> dict[str, float]:
        """The numbers by the names that CleanRL gives them."""
        return {
            "charts/learning_rate": self.learning_rate,
            "losses/qf1_values": self.qf1_value,
            "losses/qf2_values": self.qf2_value,
            "losses/qf1_loss": self.qf1_loss,
            "losses/qf2_loss": self.qf2_loss,
            "losses/qf_loss": self.critic_loss,
            "losses/actor_loss": self.actor_loss,
            "losses/entropy": self.entropy,
            "losses/alpha": self.alpha,
            "losses/alpha_loss": self.alpha_loss,
        }


Stats = PPOStats | SACStats
