"""Settings: run.env, system.env and worker-N.env declared, read, layered, edited."""
