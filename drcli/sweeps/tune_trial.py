"""A training of a sweep as an actor of Ray Tune.

Imported only where Ray is installed.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import ray
from ray import tune

from drcli.sweeps.node_trial import TrialTask, open_on_node

ANSWER_S = 10.0


class StopFlag:
    """Tells all actors that the sweep is interrupted; an actor itself."""

    def __init__(self) -> None:
        self._stopping = False

    def stop(self) -> None:
        self._stopping = True

    def is_stopping(self) -> bool:
        return self._stopping


class TuneTrial(tune.Trainable):
    """Named as its trial."""

    def setup(
        self,
        config: Mapping[str, Any],
        tasks: Mapping[str, TrialTask] | None = None,
        flag: Any = None,
    ) -> None:
        """`config` is a population's; `flag` an actor of `StopFlag`."""
        assert tasks is not None
        self._flag = flag
        self._copy = int(config["copy"])
        self._hyperparameters = dict(config["hyperparameters"])
        self._node = open_on_node(tasks[str(self.trial_name)])

    def step(self) -> dict[str, Any]:
        return asdict(self._node.step(self._is_stopping))

    def save_checkpoint(self, checkpoint_dir: str) -> dict[str, Any]:
        """The real checkpoint is in the bucket."""
        return self._node.state()

    def load_checkpoint(self, checkpoint: Any) -> None:
        self._node.restore(checkpoint, self._copy, self._hyperparameters)

    def cleanup(self) -> None:
        self._node.end()

    def _is_stopping(self) -> bool:
        try:
            stopping: bool = ray.get(self._flag.is_stopping.remote(), timeout=ANSWER_S)
        except ray.exceptions.GetTimeoutError:
            return False  # its machine is busy
        except ray.exceptions.RayError:
            return True  # the command is gone
        return stopping
