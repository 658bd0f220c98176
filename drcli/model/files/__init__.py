"""A model's files: reward_function.py, hyperparameters.json, model_metadata.json."""
