"""TensorBoard's event files, with CleanRL's names and steps."""

import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drcli.base.installation import lazy_imports
from drcli.metrics.figure_events import Event, Point, Sink, TrainingFacts

with lazy_imports():
    from tensorboard.compat.proto import event_pb2, summary_pb2, tensor_pb2, types_pb2
    from tensorboard.summary.writer import record_writer

PATTERN = "events.out.tfevents.*"
FROM_HISTORY = ".history"
"""Suffix of files that a command wrote from a model's history."""

LARGEST_BYTES = 4 << 20
"""Then a new file follows: the bucket's copy is rewritten whenever a file has grown."""

_VERSION = "brain.Event:2"
"""From this one on, TensorBoard drops what was given up before a start."""


class EventFile(Sink):
    """The file of one start of a training; TensorBoard joins those of a folder.

    Earlier files' figures of later steps are dropped. `earlier` points are for a folder without a
    file: then nothing of earlier files counts, as the bucket may have another machine's.

    Raises:
        OSError: The file cannot be written.
        ImportError: The package is not installed.
    """

    takes = (Point,)

    def __init__(
        self, folder: Path, facts: TrainingFacts, earlier: Sequence[Point], ending: str = ""
    ) -> None:
        self.name = f"TensorBoard ({folder})"
        self._folder, self._ending = folder, ending
        self._starts = 0
        folder.mkdir(parents=True, exist_ok=True)
        is_first = not any(folder.glob(PATTERN))
        self._open()
        start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
        step = 0 if is_first or not facts.first_step else facts.first_step + 1
        with self._complete():
            self._write(event_pb2.Event(wall_time=time.time(), step=step, session_log=start))
            for name, text in (facts.texts or {}).items():
                self._add_text(name, text, facts.first_step)
            for point in earlier if is_first else ():
                self._add(point)

    def send(self, event: Event) -> None:
        """Write a point.

        Raises:
            OSError: The disk is full, or the folder is gone.
        """
        assert isinstance(event, Point)
        if not self._file.closed and self._file.tell() >= LARGEST_BYTES:
            self._file.close()
        if self._file.closed:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._open()
        with self._complete():
            self._add(event)

    def close(self) -> None:
        with suppress(OSError):  # what it could not write, it tries once more
            self._file.close()

    def _open(self) -> None:
        self._starts += 1
        host = socket.gethostname() or "localhost"
        name = f"events.out.tfevents.{time.time():.6f}.{host}.{os.getpid()}.{self._starts}"
        self._path, self._is_begun = self._folder / f"{name}{self._ending}", False
        try:
            self._file = self._path.open("xb")
        except OSError as error:
            raise self._named(error) from None
        self._writer = record_writer.RecordWriter(self._file)

    @contextmanager
    def _complete(self) -> Iterator[None]:
        """Write all of the block, or close the file: behind half a record nothing is readable.

        An empty file is deleted, so that a full disk gets no more of them.
        """
        try:
            if not self._is_begun:
                self._write(event_pb2.Event(wall_time=time.time(), file_version=_VERSION))
            yield
            self._file.flush()
        except OSError as error:
            self.close()
            if not self._is_begun:
                self._path.unlink(missing_ok=True)
            raise self._named(error) from None
        self._is_begun = True

    def _named(self, error: OSError) -> OSError:
        return OSError(error.errno, error.strerror, str(self._folder))

    def _add(self, point: Point) -> None:
        values = [
            summary_pb2.Summary.Value(tag=name, simple_value=value)
            for name, value in point.values.items()
        ]
        summary = summary_pb2.Summary(value=values)
        self._write(event_pb2.Event(wall_time=point.time_s, step=point.step, summary=summary))

    def _add_text(self, name: str, text: str, step: int) -> None:
        """As Markdown that is shown letter by letter."""
        shown = "\n".join(f"    {line}" for line in text.splitlines())
        kind = summary_pb2.SummaryMetadata.PluginData(plugin_name="text")
        tensor = tensor_pb2.TensorProto(dtype=types_pb2.DT_STRING, string_val=[shown.encode()])
        tensor.tensor_shape.dim.add(size=1)
        value = summary_pb2.Summary.Value(
            tag=name,
            metadata=summary_pb2.SummaryMetadata(plugin_data=kind),
            tensor=tensor,
        )
        summary = summary_pb2.Summary(value=[value])
        self._write(event_pb2.Event(wall_time=time.time(), step=step, summary=summary))

    def _write(self, event: Any) -> None:
        self._writer.write(event.SerializeToString())
