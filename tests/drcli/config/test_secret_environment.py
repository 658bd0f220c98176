"""What a reward function finds in its environment, and whom it may send signals to."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drcli.bucket.endpoint import lend_to_refreshes
from drcli.config import secret_environment
from drcli.config.loading import load_settings
from drcli.records.job import Job

SECRETS = {
    "AWS_ACCESS_KEY_ID": "AKIA1",
    "AWS_SECRET_ACCESS_KEY": "sesame1",
    "AWS_SESSION_TOKEN": "sesame2",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI": "/sesame3",
    "AWS_CONTAINER_AUTHORIZATION_TOKEN": "sesame4",
    "MINIO_ROOT_PASSWORD": "sesame5",
    "DR_MINIO_SECRET": "sesame6",
    "HTTPS_PROXY": "http://me:sesame7@proxy:3128",
    "GITHUB_TOKEN": "sesame8",
    "SSH_KEY_PASSPHRASE": "sesame9",
}
OPEN = {
    "PATH": "/bin",
    "HOME": "/home/me",
    "AWS_PROFILE": "racing",
    "AWS_SHARED_CREDENTIALS_FILE": "/home/me/.aws/credentials",
    "AWS_WEB_IDENTITY_TOKEN_FILE": "/var/run/token",
    "NO_PROXY": "localhost",
    "HTTP_PROXY": "http://proxy:3128",
    "DR_LOCAL_S3_REWARD_KEY": "custom_files/reward_function.py",
    "OMP_NUM_THREADS": "1",
}

LOOKS = """
import json, os, sys
from pathlib import Path
from drcli.config import secret_environment as withheld
from drcli.records.job import Job
job = Job.received()
with withheld.lent():
    lent = dict(os.environ)
print(json.dumps({
    "environ": dict(os.environ),
    "proc": Path("/proc/self/environ").read_text() if os.path.exists("/proc/self/environ") else "",
    "lent": lent,
    "left": sys.stdin.read(),
    "session": job.session,
    "settings": repr(job.config),
}))
"""


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch):
    monkeypatch.setattr(secret_environment, "_kept", {})


@pytest.fixture
def job(working_folder: Path) -> Job:
    with (working_folder / "system.env").open("a") as file:
        file.write("AWS_SECRET_ACCESS_KEY=sesame0\n")
    settings = load_settings(working_folder)
    return Job(settings.run, "abc", 7, None, working_folder, os.getpid())


def test_secrets_are_told_from_what_anybody_may_read():
    assert secret_environment.split({**SECRETS, **OPEN}) == (OPEN, SECRETS)


@pytest.mark.parametrize("with_secrets", [True, False])
def test_a_process_has_no_secrets_in_its_environment_and_lends_those_it_was_handed(
    job, monkeypatch, with_secrets
):
    for name, value in SECRETS.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(secret_environment, "hide_process", lambda: None)

    process = job.spawn(
        [sys.executable, "-c", LOOKS], with_secrets=with_secrets, stdout=subprocess.PIPE
    )
    found = json.loads(process.communicate(timeout=60)[0])

    for place in ("environ", "proc", "settings", "left"):
        assert "sesame" not in json.dumps(found[place]), place
    assert found["session"] == "abc"
    lent = {name: found["lent"].get(name) for name in SECRETS}
    assert lent == (SECRETS if with_secrets else dict.fromkeys(SECRETS))


def test_keys_that_expire_are_renewed_with_the_secrets_at_hand(monkeypatch):
    monkeypatch.delenv("AWS_CONTAINER_AUTHORIZATION_TOKEN", raising=False)
    secret_environment.keep({"AWS_CONTAINER_AUTHORIZATION_TOKEN": "sesame4"})
    from botocore.credentials import RefreshableCredentials

    asked: list[str | None] = []

    def fetch() -> dict[str, str]:
        asked.append(os.environ.get("AWS_CONTAINER_AUTHORIZATION_TOKEN"))
        return {
            "access_key": "a",
            "secret_key": "b",
            "token": "c",
            "expiry_time": "2000-01-01T00:00:00Z" if len(asked) < 2 else "2099-01-01T00:00:00Z",
        }

    credentials = RefreshableCredentials.create_from_metadata(fetch(), fetch, "test")
    lend_to_refreshes(credentials)

    assert credentials.get_frozen_credentials().access_key == "a"
    assert asked == [None, "sesame4"]
    assert "AWS_CONTAINER_AUTHORIZATION_TOKEN" not in os.environ


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")
def test_a_process_that_has_secrets_can_hide_them_from_others_even_of_root():
    script = (
        "from drcli.config import secret_environment as withheld; import ctypes, os, subprocess;"
        "withheld.hide_process();"
        "print(ctypes.CDLL(None).prctl(3, 0, 0, 0, 0), flush=True);"  # PR_GET_DUMPABLE
        "subprocess.run(['sh', '-c', 'echo $GITHUB_TOKEN $HOME; cat /proc/$PPID/environ'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, **SECRETS, "HOME": "/home/me"},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )

    dumpable, own, *shown = done.stdout.splitlines()
    assert (dumpable, own) == ("0", "sesame8 /home/me")
    assert "sesame" not in "".join(shown)


SIGNALS = """
import os, signal, subprocess, sys
from drcli.base import confinement
confinement.install()
try:
    %s
except PermissionError as error:
    print(error.strerror)
"""


@pytest.mark.parametrize(
    "code",
    [
        "os.kill(os.getppid(), 9)",
        "os.kill(os.getppid(), 15)",
        "os.kill(-os.getpgid(os.getppid()), 9)",
        "os.killpg(os.getpgid(os.getppid()), 9)",
        "os.kill(-1, 0)",
        "signal.pidfd_send_signal(os.pidfd_open(os.getppid()), 9)",
    ],
)
def test_racers_code_cannot_send_signals_to_whoever_started_it(code):
    done = subprocess.run(
        [sys.executable, "-c", SIGNALS % code],
        capture_output=True,
        text=True,
        start_new_session=True,
        timeout=60,
    )

    assert done.returncode == 0
    assert "must not send signals" in done.stdout


@pytest.mark.parametrize(
    ("code", "ends"),
    [
        ("os.kill(os.getpid(), 15)", -15),
        ("os.killpg(0, 15)", -15),
        ("p = subprocess.Popen(['sleep', '60']); p.kill(); sys.exit(p.wait() + 10)", 1),
    ],
)
def test_racers_code_may_end_itself_and_what_it_has_started(code, ends):
    done = subprocess.run(
        [sys.executable, "-c", SIGNALS % code], start_new_session=True, timeout=60
    )

    assert done.returncode == ends
