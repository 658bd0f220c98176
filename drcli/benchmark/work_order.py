"""Messages to and from the measuring process."""

from dataclasses import dataclass

from drcli.config.run_config import RaceConfig, TrainConfig


@dataclass(frozen=True)
class WorkOrder:
    """A training to measure.

    Attributes:
        seconds: For measurements.
        most_seconds: With preparation; a long one leaves less.
    """

    race: RaceConfig
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
        prepared_s: Time from the start of the process until it had driven the first iteration.
        device: "cpu" or the name of the GPU on which it learns.
        number_format: In which it learns.
        driving_threads: Cores of the simulation.
        learning_threads: Cores of the learner.
        overlaps: Whether driving and learning take place at the same time in a training.
        cars: Cars that it drives at a time.
        episodes: Episodes of an iteration.
        epochs: Passes of an update over the steps.
        batch_size: Steps in a minibatch.
        weight_bytes: Size of a checkpoint's weights.
    """

    prepared_s: float
    device: str
    number_format: str
    driving_threads: int
    learning_threads: int
    overlaps: bool
    cars: int
    episodes: int
    epochs: int
    batch_size: int
    weight_bytes: int


@dataclass(frozen=True)
class Rates:
    """What was measured; the second number of each pair counts seconds of one core's time.

    Attributes:
        simulation_steps_per_s: Motion, camera, reward and rules, with drawn actions.
        driving_steps_per_s: The same with the policy, as a simulation worker drives.
        driving_steps_per_core_s: For a second of processor time, all cores added.
        learning_samples_per_s: Samples that the learner takes: each step once for each epoch.
        learning_samples_per_core_s: For a second of processor time; of no use with a GPU.
        gradient_steps_per_s: Minibatches.
        core_s: Processor time of the whole process.
        memory_bytes: Most memory of the process, in bytes.
        step_bytes: Size of a packed step, as it travels through the bucket.
    """

    simulation_steps_per_s: float
    driving_steps_per_s: float
    driving_steps_per_core_s: float
    learning_samples_per_s: float
    learning_samples_per_core_s: float
    gradient_steps_per_s: float
    core_s: float
    memory_bytes: int
    step_bytes: float
