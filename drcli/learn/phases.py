"""The phases of a training with a teacher; importing them loads no torch."""

from typing import Literal

Phase = Literal["teacher", "distillation", "ppo"]
"""Of a teacher that sees the state, then of its student, then of that from its own driving."""

FINE_LR = 3e-5
"""Limit. With small deviations, 1e-3 threw away within seconds what was learned."""

FINE_LR_OF_CHOICES = 1e-4
"""Probabilities of listed actions change more slowly."""
