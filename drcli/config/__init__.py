"""Settings: run.env, system.env and worker-N.env."""
