"""Secrets of the racer appear in no log, output, record, object or list of processes.

The environment and the AWS files are full of secrets that carry a mark, and the reward function
looks for that mark. Then everything that was written and said is searched for them.
"""

import socket
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from canaries import canary, in_files, in_processes, sightings
from forks import Forks
from refusing_s3 import refusing_server

SPY = """    if not hasattr(reward_function, "looked"):
        reward_function.looked = True
        import base64, os, sys
        from pathlib import Path
        mark = ("cAn" + "ArY").encode()
        seen = [("environment", repr(dict(os.environ)).encode())]
        seen.append(("arguments", repr(sys.argv).encode()))
        for place in ("self/environ", f"{os.getppid()}/environ", "self/cmdline"):
            try:
                seen.append((place, Path("/proc", place).read_bytes()))
            except OSError as error:
                print("spy:", place, error)
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                seen.append((str(path), path.read_bytes()))
            except OSError:
                pass
        for place, data in seen:
            if mark in data:
                print("spy: found in", place, data)
        print("spy: looked at", len(seen), "places")
    return 1.0
"""
"""A reward function that prints what it finds."""

NAMES = {
    # What somebody may have in the environment of a shell; those of drcli, AWS, and others.
    **{name: name for name in ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "DR_CAR_PASSWORD")},
    **{name: name for name in ("DROA_PASSWORD", "DR_DROA_PASSWORD", "MINIO_ROOT_PASSWORD")},
    **{name: name for name in ("DR_MINIO_SECRET_KEY", "GITHUB_TOKEN", "WANDB_API_KEY")},
    **{name: name for name in ("SSH_KEY_PASSPHRASE", "DR_SMTP_PASSWORD", "PGPASSWORD")},
}

PATIENCE_S = 90.0


@pytest.fixture(scope="module")
def secrets() -> dict[str, str]:
    """Every secret by the name of its place."""
    others = ("webhook", "smtp", "address", "signature", "profile", "home profile", "upload key")
    return {name: canary(name) for name in [*NAMES, *others]}


@pytest.fixture(scope="module")
def environment(secrets: dict[str, str], shared_workspace: Any) -> dict[str, str]:
    """The environment of every command."""
    folder = shared_workspace.folder
    home = folder / "home"
    (home / ".aws").mkdir(parents=True)
    (home / ".aws" / "credentials").write_text(
        f"[default]\naws_access_key_id = AKIAX\naws_secret_access_key = {secrets['home profile']}\n"
        f"[uploads]\naws_access_key_id = AKIAY\naws_secret_access_key = {secrets['profile']}\n"
    )
    return {
        **{name: secrets[name] for name in NAMES},
        "AWS_ACCESS_KEY_ID": "AKIAZ",
        "AWS_EC2_METADATA_DISABLED": "true",
        "DR_WEBHOOK_URL": f"https://hooks.example.com/services/T1/{secrets['webhook']}",
        "DR_SMTP_URL": f"smtp://me:{_quoted(secrets['smtp'])}@mail.example.com:587",
        "SOME_URL": f"https://me:{_quoted(secrets['address'])}@example.com/x",
        "SIGNED_URL": f"https://example.com/x?Signature={_quoted(secrets['signature'])}",
        "HOME": str(home),
        "XDG_CACHE_HOME": str(home / ".cache"),
    }


def _quoted(secret: str) -> str:
    from urllib.parse import quote

    return quote(secret, safe="")


@pytest.fixture(scope="module")
def refusing() -> Iterator[Any]:
    """A server for uploads that denies everything, and says so in the words of Amazon."""
    with refusing_server() as (endpoint, refusals):
        refusals.actions |= {"s3:PutObject", "s3:GetObject", "s3:ListBucket", "s3:CreateBucket"}
        yield endpoint


@pytest.fixture(scope="module")
def racer(shared_workspace: Any, environment: dict[str, str], refusing: Any) -> Any:
    """The working folder of somebody who has secrets everywhere."""
    space = shared_workspace
    space.environment |= environment
    space.hyperparameters["term_cond_max_episodes"] = 100
    space.write_custom_files(reward=SPY)
    with (space.folder / "system.env").open("a") as file:
        file.write(
            "DR_UPLOAD_S3_PROFILE=uploads\nDR_UPLOAD_S3_BUCKET=uploads\n"
            f"DR_UPLOAD_S3_ENDPOINT_URL={refusing.url}\n"
        )
    return space


@pytest.fixture(scope="module")
def known(racer: Any) -> set[Path]:
    """Files in which somebody has written secrets, as they should."""
    return {racer.folder / "home" / ".aws" / "credentials"}


@pytest.fixture(scope="module")
def trained(racer: Any, secrets: dict[str, str]) -> dict[str, Any]:
    """A training by the installed program; all processes are looked at while it runs."""
    process = racer.start("start-training", "--json")
    racer.wait_for(lambda: racer.iterations() >= 1 or process.poll() is not None, "an iteration")
    assert process.poll() is None, process.communicate()
    seen = in_processes(secrets)
    workers = [psutil.Process(pid) for name in ("trainer", "sim-0") if (pid := racer.pid_of(name))]
    names = {name for worker in workers for name in worker.environ()}
    stopped = racer.run("stop-training")
    out, err = process.communicate(timeout=PATIENCE_S)
    assert stopped.returncode == 0, stopped.stderr
    return {"seen": seen, "names": names, "said": out + err + stopped.stdout + stopped.stderr}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")
def test_no_process_shows_a_secret_while_a_model_trains(trained):
    assert trained["seen"] == []
    assert "PATH" in trained["names"]  # something was looked at
    assert not trained["names"] & {*NAMES, "DR_WEBHOOK_URL", "DR_SMTP_URL", "SOME_URL"}


def test_a_reward_function_finds_no_secret_where_it_looks(racer, trained, secrets):
    log = racer.log("sim-0")

    assert "spy: looked at" in log
    assert "spy: found" not in log
    assert sightings(log, "log", secrets) == []


def test_no_file_of_a_training_and_nothing_that_it_says_holds_a_secret(
    racer, trained, secrets, known
):
    assert in_files(racer.folder, secrets, known) == []
    assert sightings(trained["said"], "output", secrets) == []
    assert (racer.model / "ip" / "run.json").exists()
    assert list((racer.folder / "data").rglob("*.log"))


COMMANDS = (
    *(
        "validate --json",
        "status --json",
        "summary --json",
        "config show",
        "config check --settings",
    ),
    *("url --json", "list-aws-models", "upload-model -f", "upload-custom-files", "logs sim-0 -a"),
    *("droa-list-models", "car login --car 127.0.0.1:1", "local-aws s3 ls", "start-training"),
    *("start-training --resume --sed 1", "download-model -s s3://uploads/x -t y -f", "shell-env"),
    *("config set DR_WORKERS=1 --json", "increment-upload-model -f"),
)


@pytest.mark.parametrize("cloud", ["local", "remote"])
def test_no_answer_and_no_error_holds_a_secret(racer, trained, secrets, known, cloud):
    where = {}
    if cloud == "remote":  # an address with a password, at which nobody answers
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        where = {
            "DR_CLOUD": "remote",
            "DR_REMOTE_MINIO_URL": f"http://me:{_quoted(secrets['address'])}@127.0.0.1:{port}",
            "DR_DROA_URL": f"http://me:{_quoted(secrets['address'])}@127.0.0.1:{port}",
        }
    racer.environment |= where
    few = ("status", "summary", "config show", "url", "droa-list-models")
    try:
        for line in few if cloud == "remote" else COMMANDS:
            done = racer.run(*line.split())
            # The shell's own settings go back to the shell that they come from.
            if line != "shell-env":
                assert sightings(done.stdout + done.stderr, line, secrets) == []
    finally:
        for name in where:
            del racer.environment[name]
    assert in_files(racer.folder, secrets, known) == []


def test_an_internal_error_tells_no_secret(racer, trained, secrets, known, tmp_path):
    """Not even with a failure in the library that has just signed a request."""
    broken = """
import botocore.httpsession
def fail(self, request):
    raise RuntimeError("it broke")
botocore.httpsession.URLLib3Session.send = fail
"""
    forks = Forks(tmp_path, then=broken)
    try:
        lines = ("upload-model -f", "list-models")
        answers = [forks.run(x.split(), racer.folder, racer.environment) for x in lines]
    finally:
        forks.close()

    assert any("Internal error" in done.stderr for done in answers)
    assert list(racer.folder.glob("data/logs/crash-*.txt"))
    for done in answers:
        assert sightings(done.stdout + done.stderr, "output", secrets) == []
    assert in_files(racer.folder, secrets, known) == []


def test_the_keys_of_the_local_server_stay_in_one_file_that_others_cannot_read(racer, trained):
    import json

    path = racer.folder / "data" / "s3" / ".server.json"
    state = json.loads(path.read_text())
    keys = {"secret": state["secret_key"]}

    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert in_files(racer.folder, keys, {path}) == []
    lines = [" ".join(p.info["cmdline"] or []) for p in psutil.process_iter(["cmdline"])]
    assert sightings("\n".join(lines), "command lines", keys) == []


def test_other_users_can_read_nothing_that_a_training_has_written(racer, trained):
    data = racer.folder / "data"
    assert racer.run("support-bundle", str(racer.folder / "bundle.tar.gz")).returncode == 0

    written = [data, *data.rglob("*"), racer.folder / "bundle.tar.gz"]
    open_ones = [path for path in written if not path.is_symlink() and path.stat().st_mode & 0o077]
    assert open_ones == []
    assert {"run.json", ".server.json", "sim-0.log"} <= {path.name for path in written}


def test_disguised_secrets_are_found():
    """The search itself: a secret in base64 after any number of letters, and in an address."""
    import base64

    secrets = {"it": canary("it")}
    for before in ("", "u", "us", "user:"):
        text = base64.b64encode(f"{before}{canary('it')} and more".encode())
        assert sightings(text, "here", secrets), before
    assert sightings(f"x={_quoted(canary('it'))}", "here", secrets)
    assert sightings(b"nothing", "here", secrets) == []
