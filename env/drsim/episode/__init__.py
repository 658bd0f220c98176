"""An episode: simulation step, rules, reward parameters and reward function."""
