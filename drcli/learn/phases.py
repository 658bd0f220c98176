"""The phases of a training with a teacher; importing them loads no torch."""

from typing import Literal

Phase = Literal["teacher", "distillation", "ppo"]
"""A teacher that sees the state learns to drive, then a student that sees the camera learns from
it, then the student learns from what it drives itself."""

FINE_LR = 3e-5
"""Largest learning rate of a student that learns from what it drives itself. With small deviations,
a small change of the weights is a large change of the policy: 1e-3, a usual rate, threw away within
seconds what was learned."""

FINE_LR_OF_CHOICES = 1e-4
"""The same where it chooses from a list of actions: whose probabilities change more slowly."""
