"""A cluster of Ray, as a process of the training's machine uses it."""

import importlib
import io
import os
import re
import shlex
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any, Generic, TypeVar

from drcli.base.errors import SettingsError
from drcli.base.log import get_logger
from drcli.config import secret_environment
from drcli.records.job import Job
from drcli.workers.ray_extra import require_ray

KEYS = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
CONNECT_S = 10.0
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")

_logger = get_logger(__name__)

T = TypeVar("T")


class NodeLost(Exception):
    """The node or Ray's process there is gone."""


class RayMessages(io.TextIOBase):
    """Logs the first line of each message that Ray writes to standard output.

    At each node that is lost, Ray adds pages with its own state.
    """

    def write(self, text: str) -> int:
        for line in text.splitlines():
            plain = _COLOURS.sub("", line).rstrip()
            if plain and not plain[0].isspace():
                _logger.info("Ray: %s", plain)
        return len(text)


@contextmanager
def connected(job: Job) -> Iterator[Any]:
    with redirect_stdout(RayMessages()):
        ray = connect(job.config.train.ray_address, job.config.storage.cloud)
        try:
            yield ray
        finally:
            ray.shutdown()


def connect(address: str, cloud: str) -> Any:
    """The module `ray`; without an `address`, RAY_ADDRESS or this machine alone.

    Raises:
        NotAvailable: Ray is not installed.
        SettingsError: The cluster does not answer, or its nodes cannot reach the bucket.
    """
    require_ray()
    ray: Any = importlib.import_module("ray")  # whose functions have no types
    # Without an address, Ray would join any cluster that it finds on this machine.
    found = address or os.environ.get("RAY_ADDRESS") or "local"
    _refuse_silent_address(found)
    ended_by = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(
            address=found,
            include_dashboard=None if address else False,
            logging_level="ERROR",
            log_to_driver=False,
            configure_logging=False,
            namespace="drcli",
            runtime_env=_environment() if found == "local" else None,
        )
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise _no_answer(address or "RAY_ADDRESS", str(error).splitlines()[0]) from None
    finally:
        signal.signal(signal.SIGTERM, ended_by)  # Ray has its own, which ends the process
    hosts = {node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}
    others = hosts - {socket.gethostname()}
    if others and cloud == "local":
        ray.shutdown()
        raise SettingsError(
            f"DR_CLOUD=local is a bucket on this machine, which {min(others)} cannot reach.",
            remedy="Use a bucket that all nodes reach: DR_CLOUD=aws or remote.",
        )
    return ray


def _environment() -> dict[str, str] | None:
    """Ray gives the interpreter's path to a shell: a blank needs quotes."""
    quoted = shlex.quote(sys.executable)
    return None if quoted == sys.executable else {"py_executable": quoted}


def _refuse_silent_address(address: str) -> None:
    """Ray tries for minutes, and then exits."""
    host, colon, port = address.rpartition(":")
    if not colon or "/" in address or not port.isdecimal():
        return  # such as auto
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise _no_answer(address, str(error)) from None


def _no_answer(address: str, why: str) -> SettingsError:
    return SettingsError(
        f"Ray at {address} does not answer: {why}",
        remedy="Correct DR_RAY_ADDRESS, or start the cluster with `ray up` or `ray start --head`.",
    )


def keys_for_nodes(*more: str) -> dict[str, str]:
    known = secret_environment.all_secrets()
    return {name: known[name] for name in (*KEYS, *more) if name in known}


class PlacedActor(Generic[T]):
    """An actor of Ray with `look` and `stop`; it may not have a node yet."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self._ray = ray
        self._actor = actor
        self._asked: Any = None

    def look(self) -> T | None:
        """A new answer since the last look, or None.

        Raises:
            NodeLost: Its node, or its process there, is gone.
            SettingsError: It could not start.
        """
        errors = self._ray.exceptions
        if self._asked is None:
            self._asked = self._actor.look.remote()
        done, _ = self._ray.wait([self._asked], timeout=0)
        if not done:
            return None
        asked, self._asked = self._asked, None
        try:
            found: T = self._ray.get(asked)
        except (errors.RayActorError, errors.NodeDiedError) as error:
            if getattr(error, "actor_init_failed", False):
                raise SettingsError(
                    f"A node cannot start a worker: {str(error).strip().splitlines()[-1]}",
                    remedy="Install the same version of drcli on all nodes.",
                ) from None
            raise NodeLost(type(error).__name__) from None
        return found

    def call(self, method: str, *arguments: object) -> None:
        getattr(self._actor, method).remote(*arguments)

    def stop(self) -> None:
        self.call("stop")

    def give_back(self) -> None:
        with suppress(self._ray.exceptions.RayError, ValueError):
            self._ray.kill(self._actor)
