"""Messages arrive by mail, webhook and SNS; what fails says why, and never tells a secret."""

import json

import boto3
import pytest
from moto.server import ThreadedMotoServer

from drcli.base.errors import DrError
from drcli.bucket import endpoint
from drcli.config.loading import load_settings
from drcli.outside.messages import Message, open_channels, try_channels
from message_servers import hook, post_office

MESSAGE = Message(
    "end",
    "end: team/model",
    "Training is complete <!channel> @everyone.",
    {"model": "s3://bucket/team/model", "cost": 1.25},
)


@pytest.fixture
def channels(working_folder, monkeypatch):
    """The channels that these lines of system.env name."""
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "http_proxy", "https_proxy", "MY_SNS_TOPIC"):
        monkeypatch.delenv(name, raising=False)

    def opened(*lines):
        with (working_folder / "system.env").open("a") as file:
            file.write("".join(f"{line}\n" for line in lines))
        return open_channels(load_settings(working_folder, environ={}))

    return opened


@pytest.fixture
def trusted(certificate, monkeypatch):
    """A certificate that this process trusts."""
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
    return certificate


def send(channels):
    """Send to the only channel; why it failed, or None."""
    (error,) = try_channels(channels, MESSAGE).values()
    return error


def test_a_webhook_gets_what_slack_and_discord_show_and_the_facts(channels):
    with hook() as server:
        assert send(channels(f"DR_WEBHOOK_URL={server.url}")) is None

    (body,) = server.bodies
    assert "end: team/model" in body["text"]
    assert "&lt;!channel&gt;" in body["text"]  # calls nobody in Slack
    assert "Training is complete" in body["content"]
    assert body["allowed_mentions"] == {"parse": []}  # nor in Discord
    assert body["event"] == "end"
    assert body["facts"] == {"model": "s3://bucket/team/model", "cost": 1.25}


@pytest.mark.parametrize("status", [302, 404, 500])
def test_a_webhook_that_refuses_is_named_by_its_host_alone(channels, status):
    with hook() as server:
        server.statuses.append(status)
        error = send(channels(f"DR_WEBHOOK_URL={server.url}"))

    assert f"answered with status {status}" in str(error)
    assert "hook-secret" not in f"{error} {error.remedy}"


def test_a_webhook_that_is_gone_does_not_tell_its_address(channels):
    with hook() as server:
        url = server.url
    opened = channels(f"DR_WEBHOOK_URL={url}")
    error = send(opened)

    assert "cannot be reached" in str(error)
    assert "hook-secret" not in f"{error} {error.remedy} {opened[0].name}"
    assert error.__cause__ is None  # whose text has the whole address


def test_a_mail_is_encrypted_with_starttls_before_the_password_is_sent(channels, trusted):
    with post_office(trusted) as server:
        url = f"smtp://me:p%40ss@127.0.0.1:{server.port}"
        opened = channels(f"DR_SMTP_URL={url}", "DR_MAIL_TO=you@example.com, her@example.com")
        assert send(opened) is None

    (mail,) = server.mails
    assert server.encrypted
    assert server.logins == [("me", "p@ss")]
    assert "Subject: [drcli] end: team/model" in mail
    assert "To: you@example.com, her@example.com" in mail
    assert "From: you@example.com" in mail
    assert "cost: 1.25" in mail


def test_a_mail_over_smtps_has_its_own_sender(channels, trusted):
    with post_office(trusted, at_once=True) as server:
        lines = f"DR_SMTP_URL=smtps://127.0.0.1:{server.port}", "DR_MAIL_TO=you@example.com"
        assert send(channels(*lines, "DR_MAIL_FROM=car@example.com")) is None

    assert server.encrypted
    assert server.logins == []
    assert "From: car@example.com" in server.mails[0]


def test_no_password_goes_over_a_plain_connection(channels):
    with post_office(None) as server:
        url = f"smtp://me:hunter2@127.0.0.1:{server.port}"
        error = send(channels(f"DR_SMTP_URL={url}", "DR_MAIL_TO=you@example.com"))

    assert "offers no encryption" in str(error)
    assert "hunter2" not in f"{error} {error.remedy}"
    assert server.logins == []
    assert server.mails == []


def test_a_mail_without_a_login_may_go_plain(channels):
    with post_office(None) as server:
        url = f"smtp://127.0.0.1:{server.port}"
        assert send(channels(f"DR_SMTP_URL={url}", "DR_MAIL_TO=you@example.com")) is None

    assert len(server.mails) == 1


def test_a_certificate_that_nobody_has_signed_is_refused(channels, certificate):
    with post_office(certificate, at_once=True) as server:
        url = f"smtps://127.0.0.1:{server.port}"
        error = send(channels(f"DR_SMTP_URL={url}", "DR_MAIL_TO=you@example.com"))

    assert "cannot be reached" in str(error)
    assert server.mails == []


def test_a_wrong_password_and_a_refused_recipient_are_told(channels, trusted):
    with post_office(trusted) as server:
        lines = f"DR_SMTP_URL=smtp://me:wrong-one@127.0.0.1:{server.port}", "DR_MAIL_TO=a@b.org"
        opened = channels(*lines)
        server.password = "right"
        wrong = send(opened)
        server.password = "wrong-one"
        server.refuses = "550 no such person"
        refused = send(opened)

    assert "refuses the login" in str(wrong)
    assert "wrong-one" not in f"{wrong} {wrong.remedy}"
    assert "does not take the mail" in str(refused)


@pytest.fixture
def topic(monkeypatch, working_folder):
    """A topic of SNS, and the queue that gets its messages."""
    moto = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    moto.start()
    host, port = moto.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    monkeypatch.setenv("AWS_CONFIG_FILE", str(working_folder / "none"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(working_folder / "none"))
    endpoint.session_of.cache_clear()
    region = {"region_name": "eu-west-1"}
    sns, sqs = boto3.client("sns", **region), boto3.client("sqs", **region)
    arn = sns.create_topic(Name="racing")["TopicArn"]
    queue = sqs.create_queue(QueueName="mine")["QueueUrl"]
    wanted = {"QueueUrl": queue, "AttributeNames": ["QueueArn"]}
    queue_arn = sqs.get_queue_attributes(**wanted)["Attributes"]["QueueArn"]
    sns.subscribe(TopicArn=arn, Protocol="sqs", Endpoint=queue_arn)
    yield (
        arn,
        lambda: [
            json.loads(message["Body"])
            for message in sqs.receive_message(QueueUrl=queue, MaxNumberOfMessages=10).get(
                "Messages", []
            )
        ],
    )
    sns.close()
    sqs.close()
    endpoint.session_of.cache_clear()
    moto.stop()


def test_a_topic_gets_subject_text_and_event(channels, topic, monkeypatch):
    arn, received = topic

    assert send(channels(f"DR_SNS_TOPIC_ARN={arn}")) is None

    (message,) = received()
    assert message["Subject"] == "end: team/model"
    assert "cost: 1.25" in message["Message"]
    assert message["MessageAttributes"]["event"]["Value"] == "end"
    error = send(channels(f"DR_SNS_TOPIC_ARN={arn}-gone"))
    assert "does not take messages" in str(error)


def test_the_topic_of_on_the_spot_is_taken_if_no_other_is_set(channels, topic, monkeypatch):
    arn, received = topic
    monkeypatch.setenv("MY_SNS_TOPIC", arn)

    assert send(channels()) is None
    assert len(received()) == 1


def test_the_command_tells_which_places_took_the_message(channels, dr, capsys, working_folder):
    with hook() as server, post_office(None) as post:
        channels(
            f"DR_WEBHOOK_URL={server.url}",
            "DR_MAIL_TO=you@example.com",
            f"DR_SMTP_URL=smtp://127.0.0.1:{post.port}",
        )
        post.refuses = "550 no"
        code = dr("send-message", "Does this arrive?", "--json")

    printed = capsys.readouterr()
    report = json.loads(printed.out.splitlines()[-1])
    assert code == 4
    assert report["sent"] == ["the webhook at 127.0.0.1"]
    assert list(report["failed"]) == ["mail to you@example.com"]
    assert "does not take the mail" in printed.err
    assert "Does this arrive?" in server.bodies[0]["text"]
    assert "hook-secret" not in printed.out + printed.err


def test_without_a_place_the_command_names_the_settings(working_folder, dr, capsys, monkeypatch):
    monkeypatch.delenv("MY_SNS_TOPIC", raising=False)

    assert dr("send-message", "hello") == 3
    assert "DR_WEBHOOK_URL" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        "DR_WEBHOOK_URL=ftp://x/hook-secret",
        "DR_SMTP_URL=http://me:hunter2@host",
        "DR_MAIL_TO=nobody",
        "DR_SNS_TOPIC_ARN=my-topic",
        "DR_MESSAGE_EVENTS=start,lunch",
        "DR_MAIL_TO=you@example.com",
    ],
)
def test_wrong_addresses_are_refused_by_name_and_without_their_secrets(channels, line):
    with pytest.raises(DrError) as refused:
        channels(line)

    told = f"{refused.value} {refused.value.remedy}"
    assert line.partition("=")[0] in told
    assert "hook-secret" not in told
    assert "hunter2" not in told
