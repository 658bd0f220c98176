"""The process that calls the reward functions of a worker's cars.

`python -m drcli.drive.reward_server DESCRIPTOR PARENT_PID`, with a connection's descriptor.
It has neither keys nor a bucket, and reaches only what `reward_access` allows. It and whatever
it has started end with the worker.
"""

import errno
import json
import os
import socket
import sys
import traceback
from contextlib import suppress
from importlib.util import find_spec, module_from_spec
from os import _exit  # which the racer's code may replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from drcli.base.framing import WireError, framed, receive
from drcli.base.processes import keep_descendants, search_as_usual
from drcli.drive.reward_access import confine_reward
from drcli.records.reward import MOST_BYTES, CallFailure, Calls, Load, RewardResponse

if TYPE_CHECKING:
    from drsim.errors import RewardError


class _Server:
    def __init__(self, connection: socket.socket) -> None:
        # The whole simulation takes a second to load, and hardly a reward function needs it.
        spec = find_spec("drsim")
        assert spec is not None
        sys.modules["drsim"] = module_from_spec(spec)
        from drsim.episode.load_reward import load_reward_function
        from drsim.episode.reward import RewardFunction, checked_rewards
        from drsim.errors import RewardError

        for name in [name for name in sys.modules if name.split(".")[0] == "drsim"]:
            del sys.modules[name]
        self._load, self._checked, self._error = load_reward_function, checked_rewards, RewardError
        self._connection = connection
        self._functions: list[RewardFunction] = []
        self._waypoints: dict[bool, list[tuple[float, float]]] = {}
        self._calls = 0
        sys.excepthook = self._explain

    def run(self) -> None:
        order = Load.decode(receive(self._connection, MOST_BYTES))
        file = Path(order.file)
        free = confine_reward(file.parent)
        search_as_usual()
        try:
            self._functions = [self._load(file) for _ in range(order.cars)]
        except self._error as error:
            self._send(RewardResponse(failures=[_failure(0, error)]))
            return
        self._send(RewardResponse(free=sorted(free), pid=os.getpid()))
        while True:
            self._send(self._answer(Calls.decode(receive(self._connection, MOST_BYTES))))

    def _answer(self, calls: Calls) -> RewardResponse:
        failures: list[CallFailure] = []

        def note(call: int, error: "RewardError") -> float:
            failures.append(_failure(call, error))
            return 0.0

        self._waypoints.update(calls.waypoints)
        self._calls = len(calls.params)
        for params in calls.params:
            params["waypoints"] = self._waypoints[params["is_reversed"]].copy()
        functions = [self._functions[car] for car in calls.cars]
        try:
            done = self._checked(functions, calls.params, calls.deadline_s, note)
        except self._error as error:
            return self._failed([*failures, _failure(0, error)])
        return RewardResponse(done.rewards, done.seconds, failures)

    def _failed(self, failures: list[CallFailure]) -> RewardResponse:
        """No other call was made after the failure."""
        nothing = [0.0] * self._calls
        return RewardResponse(nothing, nothing, failures)

    def _explain(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        """For code that swallows every exception, or a bug."""
        if isinstance(error, self._error):
            self._send(self._failed([_failure(0, error)]))
        else:
            traceback.print_exception(kind, error, trace)

    def _send(self, answer: RewardResponse) -> None:
        self._connection.sendall(framed(answer.encode()))


def _failure(call: int, error: "RewardError") -> CallFailure:
    cause = error.__cause__
    return CallFailure(
        call=call,
        message=str(error),
        kind=error.kind,
        reason=error.reason,
        file=None if error.file is None else str(error.file),
        line=error.line,
        source=error.source,
        params=json.dumps(error.params),
        cause="" if cause is None else type(cause).__name__,
        out_of_memory=isinstance(cause, MemoryError)
        or (isinstance(cause, OSError) and cause.errno == errno.ENOMEM),
    )


def main(descriptor: int, parent_pid: int) -> None:
    keep_descendants(parent_pid)
    os.set_inheritable(descriptor, False)
    with suppress(WireError, OSError):  # the worker has closed the connection, or has ended
        _Server(socket.socket(fileno=descriptor)).run()
    sys.stdout.flush()
    _exit(0)  # does not wait for threads of the racer's code


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
