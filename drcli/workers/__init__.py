"""The worker processes: simulation, trainer, evaluator; and how a race is built from files."""
