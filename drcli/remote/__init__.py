"""DeepRacer on AWS, and the physical car."""
