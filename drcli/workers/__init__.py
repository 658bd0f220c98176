"""What every worker process has: signals, log, heartbeat, cores, limits of a racer's code."""
