"""A spot machine without Amazon: its metadata, its programs in a fake root, and its systemd."""

import configparser
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import drcli.outside.aws.boot
from metadata_server import MetadataServer

BOOT = Path(drcli.outside.aws.boot.__file__)

PROGRAMS = {
    "apt-get": 'echo "apt-get $*" >> "$CALLS"; [ ! -e "$DRCLI_SPOT_ROOT/no-packages" ]',
    "useradd": 'echo "useradd $*" >> "$CALLS"',
    "id": "exit 1",
    "chown": 'echo "chown $*" >> "$CALLS"',
    "systemctl": 'echo "systemctl $*" >> "$CALLS"',
    "journalctl": 'cat "$DRCLI_SPOT_ROOT/journal" 2>/dev/null',
    "python3": 'mkdir -p "$3/bin"; cp "$FAKE_PYTHON" "$3/bin/python"',
}
"""What the boot program calls, as shell scripts that write down how they were called."""

PIP = 'echo "pip $*" >> "$CALLS"; case "$*" in *download.pytorch.org*) exit 1;; esac'


class Unit(configparser.ConfigParser):
    """A unit of systemd, whose names have capitals."""

    def optionxform(self, optionstr: str) -> str:
        """Keep a name as it is."""
        return optionstr


class FakeMachine:
    """A machine whose root is a folder.

    Args:
        root: An empty folder.
        facts: What its user data tell it.
        endpoint: Stands in for Amazon.
        keys: Of its role: AccessKeyId, SecretAccessKey and Token.
        instance: Its id.
        settle: Variables for the programs that it runs.
    """

    def __init__(
        self,
        root: Path,
        facts: Mapping[str, Any],
        endpoint: str,
        keys: Mapping[str, str],
        instance: str = "i-0123456789abcdef0",
        settle: Mapping[str, str] | None = None,
    ) -> None:
        self.root, self.instance = root, instance
        self._opened = ExitStack()
        self._service: subprocess.Popen[bytes] | None = None
        self.metadata = self._opened.enter_context(MetadataServer())
        self.metadata.describe(
            {
                "instance-id": instance,
                "instance-type": "c7i.xlarge",
                "placement/availability-zone": "us-east-1a",
                "instance-life-cycle": "spot",
                "iam/security-credentials/": "machine",
                "iam/security-credentials/machine": json.dumps(
                    {**keys, "Code": "Success", "Expiration": "2099-01-01T00:00:00Z"}
                ),
            }
        )
        programs = root / "programs"
        programs.mkdir(parents=True)
        for name, script in PROGRAMS.items():
            _program(programs / name, script)
        _program(root / "fake-python", PIP)
        (root / "etc/drcli").mkdir(parents=True)
        (root / "etc/drcli/machine.json").write_text(json.dumps(facts))
        self.calls_file = root / "calls.txt"
        self.calls_file.touch()
        self.environment = {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "HOME": str(root),
            "CALLS": str(self.calls_file),
            "FAKE_PYTHON": str(root / "fake-python"),
            "DRCLI_SPOT_ROOT": str(root),
            "DRCLI_SPOT_PAUSE_S": "0",
            "AWS_ENDPOINT_URL": endpoint,
            "AWS_EC2_METADATA_SERVICE_ENDPOINT": self.metadata.address,
            **(settle or {}),
        }

    @property
    def calls(self) -> list[str]:
        """How the programs were called."""
        return self.calls_file.read_text().splitlines()

    def boot(self, command: str = "start", **variables: str) -> "subprocess.CompletedProcess[str]":
        """Run the boot program."""
        return subprocess.run(
            [sys.executable, str(BOOT), command],
            env={**self.environment, **variables},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    def file(self, path: str) -> str:
        """Content of a file of the machine."""
        return (self.root / path.removeprefix("/")).read_text()

    def unit(self, name: str) -> Unit:
        """A unit of systemd that was written."""
        found = Unit(strict=False, interpolation=None)
        found.read_string(self.file(f"/etc/systemd/system/{name}"))
        return found

    def service(self, **variables: str) -> "subprocess.Popen[bytes]":
        """Start the training as systemd would; end it with `after_service`."""
        unit = self.unit("drcli-training.service")["Service"]
        program = f"{self.root}{unit['ExecStart']}".split()
        given = dict(word.split("=", 1) for word in shlex.split(self.file(unit["EnvironmentFile"])))
        assert unit["StandardOutput"] == "journal+console"
        with self.journal.open("w") as journal:
            self._service = subprocess.Popen(
                program,
                cwd=f"{self.root}{unit['WorkingDirectory']}",
                env={**self.environment, **given, **variables},
                stdout=journal,
                stderr=subprocess.STDOUT,
            )
        return self._service

    @property
    def journal(self) -> Path:
        """What the training has printed since its last start."""
        return self.root / "journal"

    def after_service(self, code: int, **variables: str) -> bool:
        """What systemd does after an end; whether it would start the service again."""
        how, status = ("killed", "KILL") if code < 0 else ("exited", str(code))
        done = self.boot("ended", EXIT_CODE=how, EXIT_STATUS=status, **variables)
        assert done.returncode == 0, done.stdout + done.stderr
        unit = self.unit("drcli-training.service")
        condition = unit["Unit"]["ConditionPathExists"].removeprefix("!")
        assert unit["Service"]["Restart"] == "always"
        return not Path(f"{self.root}{condition}").exists()

    def close(self) -> None:
        """Stop its training, if a test failed meanwhile, and its metadata."""
        with self._opened:
            if self._service is not None and self._service.poll() is None:
                self._service.terminate()
                try:
                    self._service.wait(60)
                except subprocess.TimeoutExpired:
                    self._service.kill()
                    self._service.wait()


def _program(path: Path, script: str) -> None:
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
