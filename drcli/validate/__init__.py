"""The rules: what a training, the DeepRacer console and the physical car insist on."""
