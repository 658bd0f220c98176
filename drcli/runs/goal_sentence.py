"""What ends a training, as one sentence for its start. The trainer holds it: `worker.goals`."""

from drcli.exchange.job import Job
from drcli.modelfiles.hyperparameters import Hyperparameters


def ending(job: Job, parameters: Hyperparameters) -> str:
    """Everything that ends a training by itself, and the command that ends it at any time."""
    settings = job.config.train
    ways = []
    if job.until_laps is not None:
        ways.append(
            "once a checkpoint completes all its evaluation laps, "
            f"at least {job.until_laps} (--until-laps)"
        )
    if job.max_minutes is not None:
        given = job.max_minutes == settings.train_max_minutes
        ways.append(
            f"after {job.max_minutes:g} minutes "
            f"({'DR_TRAIN_MAX_MINUTES' if given else '--max-minutes'})"
        )
    ways.append(_iterations(settings.train_max_iterations, parameters.term_cond_max_episodes))
    if settings.train_stop_reward is not None:
        ways.append(
            f"at a mean reward of {settings.train_stop_reward:g} over 100 episodes "
            "(DR_TRAIN_STOP_REWARD)"
        )
    if settings.train_stop_progress > 0:
        ways.append(
            f"at {settings.train_stop_progress:g} % of mean progress in "
            f"{settings.train_stop_evaluations} evaluations in a row (DR_TRAIN_STOP_PROGRESS)"
        )
    return f"Ends {', or '.join([*ways, 'with dr-stop-training'])}."


def _iterations(setting: int, hyperparameter: int) -> str:
    """The smaller limit of the two: it counts, and the other one never does."""
    if 0 < setting <= hyperparameter:
        return f"after {_counted(setting)} (DR_TRAIN_MAX_ITERATIONS)"
    return f"after {_counted(hyperparameter)} (term_cond_max_episodes)"


def _counted(iterations: int) -> str:
    return "1 iteration" if iterations == 1 else f"{iterations:,} iterations"
