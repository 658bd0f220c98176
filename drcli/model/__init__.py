"""A model in a bucket: keys, checkpoints, history, scores, traces, notes and its three files."""
