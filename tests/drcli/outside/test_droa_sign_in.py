"""Signing in to DeepRacer on AWS: keys, their cache, and everything that can go wrong."""

import json
import os
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest

from drcli.base.errors import SettingsError
from drcli.outside.droa import droa_session
from drcli.outside.droa.droa_session import Keys, cache_path, load_keys, save_keys
from droa_server import IDENTITIES, PASSWORD, USER

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)


def some_keys(seconds_left: float = 3600.0) -> Keys:
    return Keys("access", "secret", "token", NOW + timedelta(seconds=seconds_left))


def only_error(capsys) -> str:
    printed = capsys.readouterr()
    errors = [line for line in printed.err.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert "Traceback" not in printed.err
    return errors[0]


def test_one_sign_in_serves_many_commands(droa, fake):
    for _ in range(3):
        assert droa("droa-list-models") == 0

    assert fake.sign_ins == 1


def test_only_the_owner_can_read_the_keys_and_there_is_no_password(droa, fake, home):
    droa("droa-login")

    (file,) = (home / ".droa-cache").iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert file == cache_path(IDENTITIES, USER)
    assert PASSWORD not in file.read_text()
    assert USER not in file.read_text()


def test_the_name_of_the_cache_is_that_of_the_reference(home):
    # First 16 hex digits of sha256("pool:me").
    assert cache_path("pool", "me") == home / ".droa-cache" / "2f3c80d4278a766c.json"


def test_a_folder_that_others_could_read_is_closed(home):
    (home / ".droa-cache").mkdir(mode=0o755)

    save_keys(cache_path("pool", "me"), some_keys())

    assert stat.S_IMODE((home / ".droa-cache").stat().st_mode) == 0o700


@pytest.mark.parametrize(
    ("seconds_left", "used"), [(3600, True), (61, True), (60, False), (-5, False)]
)
def test_keys_are_used_while_they_have_more_than_a_minute(tmp_path, seconds_left, used):
    path = tmp_path / "keys.json"
    save_keys(path, some_keys(seconds_left))

    found = load_keys(path, NOW)

    assert found == (some_keys(seconds_left) if used else None)


def good_cache() -> dict[str, str]:
    expiry = "2099-01-01T00:00:00"  # as old versions of the reference write it, without a zone
    return {"access_key": "a", "secret_key": "s", "session_token": "t", "expiry": expiry}


def test_a_cache_of_the_reference_is_read(tmp_path):
    (tmp_path / "keys.json").write_text(json.dumps(good_cache()))

    found = load_keys(tmp_path / "keys.json", NOW)

    assert found == Keys("a", "s", "t", datetime(2099, 1, 1, tzinfo=UTC))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"null",
        b"[" * 100_000,
        json.dumps({**good_cache(), "expiry": "soon"}).encode(),
        json.dumps({**good_cache(), "expiry": 12}).encode(),
        json.dumps({**good_cache(), "secret_key": None}).encode(),
        json.dumps({**good_cache(), "session_token": ""}).encode(),
        json.dumps({k: v for k, v in good_cache().items() if k != "access_key"}).encode(),
    ],
)
def test_a_damaged_cache_is_ignored(tmp_path, content):
    (tmp_path / "keys.json").write_bytes(content)

    assert load_keys(tmp_path / "keys.json", NOW) is None


def test_a_link_in_place_of_the_cache_is_ignored(tmp_path):
    save_keys(tmp_path / "real.json", some_keys())
    (tmp_path / "keys.json").symlink_to(tmp_path / "real.json")

    assert load_keys(tmp_path / "keys.json", NOW) is None


def test_a_damaged_cache_leads_to_a_new_sign_in(droa, fake, home):
    droa("droa-login")
    cache_path(IDENTITIES, USER).write_text("{")

    assert droa("droa-list-models") == 0
    assert fake.sign_ins == 2


def test_a_cache_that_cannot_be_written_is_said_and_nothing_else(droa, home, capsys):
    (home / ".droa-cache").write_text("a file in its place")

    assert droa("droa-list-models") == 0
    assert "asks for the password again" in capsys.readouterr().err


def test_keys_that_the_server_calls_expired_are_replaced(droa, fake):
    droa("droa-login")
    fake.expire_keys()  # the cache still thinks that they are valid

    assert droa("droa-list-models") == 0
    assert fake.sign_ins == 2


def test_keys_that_nobody_issued_are_replaced(droa, fake):
    droa("droa-login")
    fake.issued.clear()

    assert droa("droa-list-models") == 0
    assert fake.sign_ins == 2


def test_keys_that_are_refused_twice_end_the_command(droa, fake, capsys):
    fake.key_lifetime = timedelta(seconds=-1)

    assert droa("droa-list-models") == 4
    assert "security token included in the request is expired" in only_error(capsys)
    assert fake.sign_ins == 2


def test_a_wrong_signature_is_refused(droa, fake, capsys):
    droa("droa-login")
    for keys in fake.issued.values():
        keys.secret = "another one"

    assert droa("droa-list-models") == 4
    assert "403: The request signature we calculated does not match" in only_error(capsys)


def test_a_wrong_clock_is_no_reason_to_sign_in_again(droa, fake, capsys, monkeypatch):
    droa("droa-login")
    capsys.readouterr()
    later = datetime.now(UTC).replace(tzinfo=None) + timedelta(minutes=20)
    monkeypatch.setattr("botocore.auth.get_current_datetime", lambda remove_tzinfo=True: later)

    code = droa("droa-list-models")

    printed = capsys.readouterr().err
    assert code == 4
    assert "Signature expired" in printed
    assert "clock" in printed
    assert fake.sign_ins == 1


def test_signing_out_deletes_the_keys(droa, fake, home, capsys):
    droa("droa-login")
    capsys.readouterr()

    assert droa("droa-logout", "--json") == 0
    assert json.loads(capsys.readouterr().out)["deleted"] is True
    assert list((home / ".droa-cache").iterdir()) == []
    assert droa("droa-logout", "--json") == 0
    assert json.loads(capsys.readouterr().out)["deleted"] is False


def test_a_login_asks_cognito_even_with_keys(droa, fake, capsys):
    droa("droa-login")
    capsys.readouterr()

    assert droa("droa-login", "--json") == 0

    report = json.loads(capsys.readouterr().out)
    assert fake.sign_ins == 2
    assert report["username"] == USER
    assert datetime.fromisoformat(report["expires"]) > datetime.now(UTC)


def test_a_wrong_password_is_said(droa, fake, capsys):
    assert droa("droa-list-models", "--password", "wrong") == 4

    error = only_error(capsys)
    assert "Incorrect username or password" in error
    assert "wrong." not in error


@pytest.mark.parametrize(
    ("challenge", "words"),
    [
        ("NEW_PASSWORD_REQUIRED", "temporary one and must be replaced"),
        ("MFA_SETUP", "second factor"),
        ("DEVICE_SRP_AUTH", "more than a password"),
    ],
)
def test_what_only_a_browser_can_answer_is_explained(droa, fake, capsys, challenge, words):
    fake.challenge = challenge

    assert droa("droa-login") == 4
    error = only_error(capsys)
    assert words in error
    assert challenge in error


@pytest.mark.parametrize("challenge", ["SOFTWARE_TOKEN_MFA", "SMS_MFA", "EMAIL_OTP"])
@pytest.mark.parametrize(("code", "exit_code"), [("123456", 0), ("000000", 4)])
def test_a_second_factor_is_asked_for(droa, fake, monkeypatch, challenge, code, exit_code):
    fake.challenge = challenge
    asked = []
    monkeypatch.setattr(
        "drcli.cli.prompts.secret",
        lambda question, remedy: (
            asked.append(question) or (PASSWORD if "Password" in question else code)
        ),
    )

    assert droa("droa-login") == exit_code
    assert len(asked) == 2
    assert "Code" in asked[1]


def test_a_client_that_allows_no_passwords_is_explained(droa, fake, capsys):
    fake.password_flow = False

    assert droa("droa-login") == 4
    assert "USER_PASSWORD_AUTH" in only_error(capsys)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--user-pool-client-id", "other", "sign-in does not exist"),
        ("--identity-pool-id", "eu-west-1:other", "IdentityPool not found"),
        ("--user-pool-id", "eu-west-1_Other", "Token is not from a supported provider"),
    ],
)
def test_a_wrong_pool_is_said(droa, capsys, option, value, words):
    assert droa("droa-login", option, value) == 4
    assert words in only_error(capsys)


def test_a_missing_user_name_and_address_are_named(dr, home, working_folder, fake, capsys):
    assert dr("droa-list-models") == 3
    assert "DR_DROA_URL is not set" in only_error(capsys)
    assert dr("droa-list-models", "--url", fake.url) == 3
    assert "DR_DROA_USERNAME is not set" in only_error(capsys)


def test_settings_of_aws_for_other_buckets_do_no_harm(droa, fake, home, monkeypatch):
    (home / ".aws").mkdir()
    (home / ".aws" / "config").write_text("[default]\nendpoint_url = http://127.0.0.1:1\n= damaged")
    monkeypatch.setenv("AWS_PROFILE", "nowhere")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "other")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "other")
    (home / ".netrc").write_text("default login me password other\n")

    assert droa("droa-list-models") == 0
    assert fake.sign_ins == 1


def test_keys_are_never_printed():
    assert "secret" not in repr(some_keys())
    assert "token" not in repr(some_keys())


def test_a_cache_is_whole_or_absent(tmp_path, monkeypatch):
    save_keys(tmp_path / "keys.json", some_keys())

    def full(path, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(droa_session.Path, "replace", full)
    with pytest.raises(OSError, match="No space"):
        save_keys(tmp_path / "keys.json", some_keys(7200))

    assert load_keys(tmp_path / "keys.json", NOW) == some_keys()
    assert [path.name for path in tmp_path.iterdir()] == ["keys.json"]


def test_without_a_terminal_the_password_comes_from_standard_input(monkeypatch):
    import io

    from drcli.cli import prompts

    monkeypatch.setattr("sys.stdin", io.StringIO("Secret-1\nmore\n"))
    assert prompts.secret("Password", "Give it.") == "Secret-1"

    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(SettingsError, match="Password"):
        prompts.secret("Password", "Give it.")


def test_cognito_out_of_reach_is_one_sentence(droa, fake, capsys, monkeypatch, working_folder):
    monkeypatch.setenv("DR_DROA_AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    monkeypatch.setattr("botocore.retries.standard.ExponentialBackoff.delay_amount", lambda *_: 0)

    assert droa("droa-login") == 4
    assert "http://127.0.0.1:1 cannot be reached" in only_error(capsys)


def test_a_program_takes_the_password_from_a_pipe(fake, home, working_folder):
    fake.add_model("car")
    settings = {
        "DR_DROA_URL": fake.url,
        "DR_DROA_USERNAME": USER,
        "DR_DROA_AWS_ENDPOINT_URL": fake.url,
        "HOME": str(home),
    }
    code = "from drcli.cli.app import main; main(['droa-list-models'])"

    done = subprocess.run(
        [sys.executable, "-c", code],
        input=f"{PASSWORD}\n",
        env={**os.environ, **settings},
        cwd=working_folder,
        capture_output=True,
        text=True,
    )

    assert done.returncode == 0, done.stderr
    assert "car" in done.stdout
    assert done.stderr == ""
    assert PASSWORD not in done.stdout
