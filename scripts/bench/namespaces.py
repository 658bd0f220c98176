"""Network namespaces of this machine, each with one link to the rest: for benchmarks, as root."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence

import psutil

_NAME = "drjoined"


def are_possible() -> bool:
    """Whether this process may make namespaces: on Linux, as root, with iproute2."""
    return sys.platform == "linux" and os.geteuid() == 0 and shutil.which("ip") is not None


class Namespace:
    """A namespace whose processes reach one address of this machine and nothing else.

    Close it when done. Those of benchmarks that were killed are deleted by the next one.

    Args:
        number: Of the namespace in this process, less than 250.

    Attributes:
        address: Of this machine, as the processes in the namespace see it.
    """

    def __init__(self, number: int) -> None:
        own = os.getpid()
        self._name = f"{_NAME}-{own}-{number}"
        self._link = f"dj{own % 10**7}h{number}"
        network = f"10.{64 + own % 64}.{number}"
        self.address = f"{network}.1"
        far = f"dj{own % 10**7}f{number}"
        _ip("netns", "add", self._name)
        try:
            _ip("link", "add", self._link, "type", "veth", "peer", far, "netns", self._name)
            _ip("address", "add", f"{self.address}/30", "dev", self._link)
            _ip("-n", self._name, "address", "add", f"{network}.2/30", "dev", far)
            for words in ((self._link,), (far, self._name), ("lo", self._name)):
                inside = ("-n", words[1]) if len(words) > 1 else ()
                _ip(*inside, "link", "set", words[0], "up")
        except BaseException:
            self.close()
            raise

    def command(self, words: Sequence[str]) -> list[str]:
        """The command that runs another one in the namespace, as the same process."""
        return ["ip", "netns", "exec", self._name, *words]

    def set_link(self, *, up: bool) -> None:
        """Take the link down or up: packets vanish meanwhile, and connections hang."""
        _ip("link", "set", self._link, "up" if up else "down")

    def close(self) -> None:
        """Delete the namespace and its link; processes in it keep running."""
        _ip("netns", "delete", self._name)


def delete_left_over() -> None:
    """Delete the namespaces of benchmarks that have ended without doing so."""
    for line in _ip("netns", "list").splitlines():
        name = line.split()[0]
        words = name.split("-")
        if words[0] == _NAME and len(words) == 3 and not psutil.pid_exists(int(words[1])):
            _ip("netns", "delete", name)


def _ip(*words: str) -> str:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"`ip {' '.join(words)}` failed: {done.stderr.strip()}")
    return done.stdout
