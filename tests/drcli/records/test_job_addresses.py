"""Who learns the secret addresses of messages: the supervisor alone."""

import subprocess
import sys

import pytest

from unwatched import job_of

SECRETS = "DR_WEBHOOK_URL=https://hooks.example.com/canary-hook", "DR_ON_END=echo canary-end"
ECHO = [sys.executable, "-S", "-c", "import sys; print(sys.stdin.read())"]


@pytest.mark.parametrize(("private", "known"), [(True, True), (False, False)])
def test_processes_that_run_a_racers_code_do_not_get_them(tmp_path, private, known):
    job = job_of(tmp_path, *SECRETS, "DR_SMTP_URL=smtps://me:canary-mail@mail.example.com")

    process = job.spawn(ECHO, private=private, stdout=subprocess.PIPE)
    sent = process.communicate()[0].decode()

    for canary in ("canary-hook", "canary-mail", "canary-end"):
        assert (canary in sent) is known
