"""The fastest lap of a car on a track: computed with its grip, and driven in MuJoCo."""
