"""`dr local-aws` as its caller meets it: another program, called with our address and keys."""

import os

import pytest

from drcli.bucket.endpoint import Endpoint
from drcli.cli.commands.local_aws import aws_command
from drcli.config.run_config import StorageConfig

OURS = Endpoint("http://127.0.0.1:23456", access_key="AK1", secret_key="secret", engine="rclone")


@pytest.fixture
def server(monkeypatch):
    """Which server the settings mean; none is started."""

    def choose(endpoint):
        monkeypatch.setattr("drcli.bucket.server.server.ensure_running", lambda *_: endpoint)

    choose(OURS)
    return choose


@pytest.fixture
def aws(working_folder, monkeypatch):
    """An aws program that notes how it was called instead of running."""
    program = working_folder / "bin" / "aws"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    called = {}

    def become(path, arguments, environment):
        called.update(path=path, arguments=arguments, environment=environment)
        raise SystemExit(252)

    monkeypatch.setattr(os, "execve", become)
    return called


def test_everything_after_the_name_goes_to_aws_and_its_code_comes_back(dr, server, aws):
    code = dr("local-aws", "--debug", "s3", "ls", "s3://bucket/", "--recursive", "--help")

    assert code == 252
    assert aws["arguments"] == [
        *("aws", "--endpoint-url", "http://127.0.0.1:23456"),
        *("--debug", "s3", "ls", "s3://bucket/", "--recursive", "--help"),
    ]


def test_keys_travel_in_the_environment_alone(dr, server, aws):
    dr("local-aws", "s3", "ls")

    assert "secret" not in " ".join(aws["arguments"])
    assert aws["environment"]["AWS_ACCESS_KEY_ID"] == "AK1"
    assert aws["environment"]["AWS_SECRET_ACCESS_KEY"] == "secret"


def test_somebody_elses_identity_is_left_out(dr, server, aws, monkeypatch):
    monkeypatch.setenv("AWS_PROFILE", "work")
    monkeypatch.setenv("AWS_SESSION_TOKEN", "token")

    dr("local-aws", "s3", "ls")

    assert not {"AWS_PROFILE", "AWS_SESSION_TOKEN"} & aws["environment"].keys()


def test_a_missing_aws_program_exits_7_and_says_how_to_get_it(
    dr, working_folder, monkeypatch, capsys
):
    monkeypatch.setenv("PATH", str(working_folder))

    code = dr("local-aws", "s3", "ls")

    said = capsys.readouterr().err
    assert code == 7
    assert "aws is not on the PATH" in said
    assert "pipx install awscli" in said


@pytest.mark.parametrize(
    ("endpoint", "options"),
    [
        (Endpoint(None, region="eu-west-1"), []),
        (Endpoint(None, profile="work", region="eu-west-1"), ["--profile", "work"]),
        (
            Endpoint("http://far:9000", profile="minio"),
            ["--endpoint-url", "http://far:9000", "--profile", "minio"],
        ),
    ],
)
def test_other_servers_are_called_with_their_profile(server, tmp_path, endpoint, options):
    server(endpoint)

    arguments, environment = aws_command(
        StorageConfig("aws", "bucket", tmp_path), ["s3", "ls"], {"AWS_PROFILE": "mine"}
    )

    assert arguments == [*options, "s3", "ls"]
    assert environment["AWS_DEFAULT_REGION"] == endpoint.region
    assert environment["AWS_PROFILE"] == "mine"
