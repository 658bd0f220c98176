"""Messages to and from the measuring process."""

from dataclasses import dataclass

from drcli.base.json_record import SafeInt, Seconds
from drcli.config.run_config import DriveConfig, TrainConfig


@dataclass(frozen=True)
class WorkOrder:
    """A training to measure.

    Attributes:
        seconds: For measurements.
        most_seconds: With preparation; a long one leaves less.
    """

    race: DriveConfig
    train: TrainConfig
    hyperparameters: str
    metadata: str
    reward_file: str
    seconds: float
    most_seconds: float


@dataclass(frozen=True)
class Ready:
    """The measuring process is ready: what it will use.

    Attributes:
        prepared_s: From its start until it had driven the first iteration.
        device: "cpu" or the GPU on which it learns.
        number_format: In which it learns.
        driving_threads: Cores of the simulation.
        learning_threads: Cores of the learner.
        overlaps: Whether a training drives and learns at the same time.
        cars: Driven at a time.
        episodes: Per iteration.
        epochs: Passes of an update over the steps.
        batch_size: Steps in a minibatch.
        weight_bytes: Weights of a checkpoint.
    """

    prepared_s: Seconds
    device: str
    number_format: str
    driving_threads: SafeInt
    learning_threads: SafeInt
    overlaps: bool
    cars: SafeInt
    episodes: SafeInt
    epochs: SafeInt
    batch_size: SafeInt
    weight_bytes: SafeInt


@dataclass(frozen=True)
class Rates:
    """What was measured; the second of each pair is per second of one core's time.

    Attributes:
        simulation_steps_per_s: Motion, camera, reward and rules, with drawn actions.
        driving_steps_per_s: The same with the policy, as in a simulation worker.
        driving_steps_per_core_s: Per second of processor time.
        learning_samples_per_s: Samples learned: each step once per epoch.
        learning_samples_per_core_s: Per second of processor time; of no use with a GPU.
        gradient_steps_per_s: Minibatches.
        core_s: Processor time of the process.
        memory_bytes: Most memory of the process.
        step_bytes: A packed step, as in the bucket.
    """

    simulation_steps_per_s: Seconds
    driving_steps_per_s: Seconds
    driving_steps_per_core_s: Seconds
    learning_samples_per_s: Seconds
    learning_samples_per_core_s: Seconds
    gradient_steps_per_s: Seconds
    core_s: Seconds
    memory_bytes: SafeInt
    step_bytes: float
