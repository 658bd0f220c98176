"""Publishes the checkpoints of a trainer, partly in a thread."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec

from safetensors.torch import save as save_tensors

from drcli.base.errors import StorageError
from drcli.base.log import get_logger, plain
from drcli.exchange.checkpoint import CheckpointName, Counters
from drcli.learn.learner import Learner
from drcli.store.checkpoints import CheckpointStore
from drcli.store.trace_retention import TraceRetention
from drcli.workers.write_graph import GraphWriter

_logger = get_logger(__name__)

P = ParamSpec("P")


class CheckpointPublisher:
    """Publishes weights at once, then the graph while workers already drive.

    If the bucket is on this machine (`near`), the optimizer state comes with the weights, so
    that a power cut leaves both or neither; otherwise it follows.
    """

    def __init__(
        self,
        checkpoints: CheckpointStore,
        graphs: GraphWriter,
        traces: TraceRetention,
        is_ending: Callable[[], bool],
        on_weights: Callable[[], None] = lambda: None,
        *,
        near: bool = False,
    ) -> None:
        self._checkpoints = checkpoints
        self._graphs = graphs
        self._traces = traces
        self._is_ending = is_ending
        self._on_weights = on_weights
        self._near = near
        self._uploader = ThreadPoolExecutor(1, thread_name_prefix="upload")
        self._uploads: list[Future[object]] = []

    def publish(self, name: CheckpointName, learner: Learner, counters: Counters) -> None:
        """Publish weights, once the checkpoint before is uploaded.

        A process that is ending publishes them with the optimizer state or not at all.

        Raises:
            StorageError: These weights, or the checkpoint before, did not arrive.
        """
        self.join()
        tensors = learner.optimizer.tensors()
        at_once = self._near or self._is_ending()
        moments = save_tensors(tensors) if tensors and at_once else None
        state = {name: t.contiguous() for name, t in learner.model.state_dict().items()}
        weights = save_tensors(state)
        record = self._checkpoints.save(
            name.number,
            name.steps,
            weights,
            optimizer=moments,
            counters=counters,
            on_pointed=self._on_weights,
        )
        plain.info("Checkpoint> Saving in path=['%s']", record.name)
        if moments is not None:
            self.submit(self._checkpoints.forget_older_states, record.name)
        elif tensors:
            self.submit(self._checkpoints.attach_optimizer, record, save_tensors(tensors))
        self.submit(self._graphs.write, record.number, weights)
        self.submit(self._thin_traces, name.number)

    def submit(self, task: Callable[P, object], *arguments: P.args, **named: P.kwargs) -> None:
        self._uploads.append(self._uploader.submit(task, *arguments, **named))

    def join(self) -> None:
        """Raises the error of an upload."""
        while self._uploads:
            self._uploads.pop(0).result()

    def close(self) -> None:
        self._uploader.shutdown()

    def _thin_traces(self, newest: int) -> None:
        try:
            thinned = self._traces.apply(newest)
        except StorageError as error:
            _logger.warning("Old traces were not deleted: %s", error)
            return
        if thinned is not None:
            _logger.info(
                "Deleted the traces of %d older iterations (%.1f MB); %d iterations have traces. "
                "DR_TRAIN_TRACES_MAX_MB=0 keeps all.",
                thinned.iterations,
                thinned.size_bytes / 1e6,
                thinned.left,
            )
