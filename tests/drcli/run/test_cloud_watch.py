"""Logs of a training at CloudWatch: each line once, also after faults, rotations and restarts."""

import json
import os
from contextlib import suppress

import boto3
import pytest
from moto import mock_aws

from drcli.base import log
from drcli.base.errors import WorkerDied
from drcli.records.run_record import json_log, log_file
from drcli.run import log_sender
from drcli.run.log_sender import (
    CloudWatchLogs,
    LogClock,
    LogEvent,
    LogSender,
    batches,
    sent_to_cloud_watch,
)
from drcli.run.outcome import Ending, Outcome
from drcli.run.run_logs import empty_logs
from watched_run import WatchedRun

NOW_S = 1_795_000_000.0
GROUP = "/deepracer-for-cloud"
STAMP = "2026-11-18T00:26:40"
ENDING = Ending(Outcome(0, "Done."), None, lambda: False)


@pytest.fixture(scope="module")
def service():
    """CloudWatch as moto plays it; the client takes longer than all tests."""
    with pytest.MonkeyPatch.context() as patch, mock_aws():
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "testing")
        yield boto3.client("logs", region_name="us-east-1")


@pytest.fixture
def client(service):
    """CloudWatch without any logs."""
    yield service
    with suppress(service.exceptions.ResourceNotFoundException):
        service.delete_log_group(logGroupName=GROUP)


class Sender:
    """A training whose logs are sent."""

    def __init__(self, folder, connect, **settings):
        self.run = WatchedRun(folder, DR_CLOUD_WATCH_ENABLE=True, **settings)
        self.now_s = NOW_S
        self.duty = CloudWatchLogs(self.run.running, connect=connect, clock=lambda: self.now_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(LogSender, "start", lambda sender: None)  # the test calls it
            self.duty.start()
        self.sender = self.duty._sender

    def add(self, name, text, *, as_json=False):
        path = log_file(self.run.folder, "model", name)
        path = json_log(path) if as_json else path
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            file.write(text)
        return path


@pytest.fixture
def sender(tmp_path, client):
    return lambda **settings: Sender(tmp_path, lambda: client, **settings)


def sent(client, stream):
    found = client.get_log_events(
        logGroupName=GROUP, logStreamName=stream, startFromHead=True, limit=10_000
    )
    return [(event["timestamp"], event["message"]) for event in found["events"]]


def texts(client, stream):
    return [text for _, text in sent(client, stream)]


def test_each_log_is_a_stream_and_each_line_an_event_with_its_time(sender, client):
    training = sender(DR_CLOUD_WATCH_LOG_STREAM_PREFIX="night-")
    training.add("sim-0", f"{STAMP}.250Z INFO Begins.\nTraining> x\n\nunfinished")
    training.add("trainer", f"{STAMP}.000Z INFO Learns.\n")

    training.sender.send()

    assert sent(client, "night-model/sim-0") == [
        (1_794_961_600_250, f"{STAMP}.250Z INFO Begins."),
        (1_794_961_600_250, "Training> x"),
    ]
    assert texts(client, "night-model/trainer") == [f"{STAMP}.000Z INFO Learns."]


def test_the_lines_of_simulation_steps_are_sent_only_on_request(sender, client, tmp_path):
    line = "SIM_TRACE_LOG:0,1,2.0\n"
    training = sender()
    training.add("sim-0", f"{line}after\n")
    training.sender.send()
    assert texts(client, "model/sim-0") == ["after"]

    more = sender(DR_CLOUD_WATCH_SIM_TRACE=True)
    more.add("sim-0", line)
    more.sender.send()

    assert texts(client, "model/sim-0") == ["after", line.strip()]


def test_after_rotation_and_restart_every_line_is_there_once(sender, client):
    training = sender()
    path = training.add("sim-0", "one\ntwo\n")
    training.sender.send()
    training.add("sim-0", "three\n")
    os.close(log.rotate(path, 10**9))
    training.add("sim-0", "four\n")

    again = sender()
    again.sender.send()
    again.sender.send()

    assert texts(client, "model/sim-0") == ["one", "two", "three", "four"]


def test_an_unfinished_last_line_is_sent_at_the_end(sender, client):
    training = sender()
    training.add("trainer", "whole\nkilled here")
    training.sender.send()
    assert texts(client, "model/trainer") == ["whole"]

    training.sender.send_all()

    assert texts(client, "model/trainer") == ["whole", "killed here"]


def test_json_lines_are_sent_where_the_racer_wants_them(sender, client):
    training = sender(DR_LOG_JSON=True)
    record = json.dumps({"time": f"{STAMP}.000Z", "level": "INFO", "message": "Lap."})
    training.add("sim-0", f"{record}\n", as_json=True)
    training.add("sim-0", "text\n")

    training.sender.send()

    assert texts(client, "model/sim-0") == [record]


def test_a_stream_that_somebody_deletes_is_made_again(sender, client):
    training = sender()
    training.add("trainer", "one\n")
    training.sender.send()
    client.delete_log_group(logGroupName=GROUP)

    training.add("trainer", "two\n")
    training.sender.send()

    assert texts(client, "model/trainer") == ["two"]


def test_without_keys_the_training_goes_on_and_says_so_once(tmp_path, logged):
    from botocore.exceptions import NoCredentialsError

    class Refusing:
        def create_log_stream(self, **_):
            raise NoCredentialsError

    training = Sender(tmp_path, Refusing)
    training.add("trainer", "one\n")
    for _ in range(3):
        training.sender.send()
        training.duty.check()

    assert logged().count("no access keys for Amazon were found") == 1
    assert "aws configure" in logged()
    assert any("DR_CLOUD_WATCH_ENABLE" in text for text in training.run.told)
    assert any("DR_CLOUD_WATCH_ENABLE" in text for text in training.run.warnings)
    assert training.sender.left_bytes == 4  # it is sent when there are keys


def test_the_warning_goes_when_the_logs_are_taken_again(sender, client):
    training = sender()
    training.sender.failure = "Cannot send the logs."
    training.duty.check()
    assert training.run.warnings == ["Cannot send the logs."]

    training.sender.send()
    training.duty.check()

    assert training.run.warnings == []


def test_the_client_is_made_from_the_settings(tmp_path, client):
    training = Sender(tmp_path, None, DR_AWS_APP_REGION="us-east-1")
    training.add("trainer", "one\n")

    training.sender.send()

    assert texts(client, "model/trainer") == ["one"]


def test_nothing_is_asked_of_amazon_unless_the_settings_say_so(tmp_path):
    run = WatchedRun(tmp_path)
    duty = CloudWatchLogs(run.running, connect=lambda: pytest.fail("asked"))

    duty.start()
    duty.after_release(ENDING)

    assert duty._sender is None


def test_lines_without_a_time_were_not_written_before_the_last_look(sender, client):
    training = sender()
    training.add("trainer", "first\n")
    training.sender.send()
    training.now_s += 500.0
    training.sender.send()
    training.add("trainer", "second\n")
    training.sender.send()

    (one, _), (two, _) = sent(client, "model/trainer")
    assert two - one == 500_000


def test_times_never_go_back_within_a_log():
    clock = LogClock(0)
    moments = ("2026-11-18T00:00:10", "2026-11-18T00:00:09", "2026-99-99T00:00:00")
    data = "".join(f"{moment}.000Z INFO x\n" for moment in moments).encode()

    times = [event.at_ms for event in clock.events(data, with_traces=False)]

    assert times == [times[0]] * 3


@pytest.mark.parametrize(
    ("events", "sizes"),
    [
        ([LogEvent(0, "x")] * 25_000, [10_000, 10_000, 5_000]),
        ([LogEvent(0, "y" * 200_000)] * 7, [4, 3]),
        ([LogEvent(0, "a"), LogEvent(25 * 3_600_000, "b")], [1, 1]),
        ([], []),
    ],
)
def test_requests_keep_the_limits_of_cloudwatch(events, sizes):
    assert [len(batch) for batch in batches(events)] == sizes


def test_a_line_that_is_too_long_is_cut():
    [[event]] = batches([LogEvent(0, "é" * 300_000)])

    assert len(event.text.encode()) < 256 * 1024
    assert event.text.endswith("(350,000 more)")


def test_at_the_end_the_last_lines_are_sent_within_the_time(tmp_path, client):
    run = WatchedRun(tmp_path, DR_CLOUD_WATCH_ENABLE=True)
    duty = CloudWatchLogs(run.running, connect=lambda: client)
    duty.start()
    path = log_file(tmp_path, "model", "supervisor")
    path.parent.mkdir(parents=True)
    path.write_text("the end")

    duty.after_release(ENDING)

    assert texts(client, "model/supervisor") == ["the end"]
    assert log_sender.END_PATIENCE_S <= 10.0


@pytest.fixture
def evaluation(tmp_path, client):
    """Runs an evaluation that writes these texts into its log, and sends it."""

    def run(*texts, end=None, connect=lambda: client, **settings):
        job = WatchedRun(tmp_path, **{"DR_CLOUD_WATCH_ENABLE": True, **settings}).job
        path = log_file(tmp_path, "model", "evaluation")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        empty_logs(tmp_path, "model", "evaluation")
        with sent_to_cloud_watch(job, ["evaluation"], connect=connect):
            path.write_text("".join(texts))
            if end is not None:
                raise end

    return run


def test_an_evaluation_is_sent_to_a_stream_beside_those_of_the_training(evaluation, client):
    evaluation(f"{STAMP}.000Z INFO Trial 0.\n", "SIM_TRACE_LOG:0,1,2.0\n", "the end")

    assert texts(client, "model/evaluation") == [f"{STAMP}.000Z INFO Trial 0.", "the end"]


def test_each_evaluation_adds_its_whole_log_to_the_stream(evaluation, client):
    evaluation("one\n")
    evaluation("two\nand longer than the first\n")

    assert texts(client, "model/evaluation") == ["one", "two", "and longer than the first"]


def test_an_evaluation_that_fails_is_sent_to_its_end(evaluation, client):
    with pytest.raises(WorkerDied):
        evaluation("last words\n", end=WorkerDied("It died.", remedy="x"))

    assert texts(client, "model/evaluation") == ["last words"]


def test_an_evaluation_goes_on_where_cloudwatch_refuses_and_says_so_once(evaluation, told):
    evaluation("one\n", connect=refusing)

    assert len(told) == 1
    assert "no access keys for Amazon were found" in told[0]


def test_an_evaluation_asks_nothing_of_amazon_unless_the_settings_say_so(evaluation):
    evaluation("one\n", connect=lambda: pytest.fail("asked"), DR_CLOUD_WATCH_ENABLE=False)


def refusing():
    from botocore.exceptions import NoCredentialsError

    raise NoCredentialsError
