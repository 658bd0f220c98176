"""The processes that train: simulation worker, trainer, learner processes, shares and goals."""
