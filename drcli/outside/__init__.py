"""Other systems: clouds, DeepRacer on AWS, the physical car, messages."""
