"""DeepRacer training from the command line: settings, bucket, workers and learner."""

__version__ = "0.1.0"
