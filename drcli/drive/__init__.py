"""Drives cars with a policy: a race built from files, laps, evaluations, reward processes."""
