"""What dr-reward shows of a reward function: checks, pictures, comparisons."""
