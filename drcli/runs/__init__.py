"""Runs: start, watch, stop and describe the processes of a training or an evaluation."""
