"""An episode: the simulation step, its rules, reward parameters and the racer's reward function."""
