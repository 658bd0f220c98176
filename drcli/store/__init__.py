"""The bucket: keys, checkpoints, rollouts, and the embedded S3 server."""
