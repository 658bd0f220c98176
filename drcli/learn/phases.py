"""The phases of a training with a teacher; importing them loads no torch."""

from typing import Literal

Phase = Literal["teacher", "distillation", "ppo"]
"""A teacher that sees the state learns to drive, then a student that sees the camera learns from
it, then the student learns from what it drives itself."""
