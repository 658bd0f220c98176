"""Models in a DeepRacer on AWS."""
