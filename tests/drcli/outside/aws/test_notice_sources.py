"""Notices of three clouds, read from a metadata service on this machine."""

import json
import socket
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import pytest

from drcli.base.errors import SettingsError
from drcli.clouds.cloud import MetadataService, MetadataSilent
from drcli.clouds.providers.amazon import Ec2Metadata, Ec2Notices
from drcli.clouds.providers.google import GoogleNotices
from drcli.clouds.providers.microsoft import AzureNotices
from drcli.clouds.registry import CLOUDS
from metadata_server import MetadataServer

SPOT = "/latest/meta-data/spot/instance-action"
GROUP = "/latest/meta-data/autoscaling/target-lifecycle-state"
ADVICE = "/latest/meta-data/events/recommendations/rebalance"
GOOGLE = "/computeMetadata/v1/instance/"
EVENTS = "/metadata/scheduledevents?api-version=2020-07-01"
NAME = "/metadata/instance/compute/name?api-version=2021-02-01&format=text"


@pytest.fixture
def metadata():
    with MetadataServer() as server:
        yield server


def ec2(server: MetadataServer) -> Ec2Notices:
    return Ec2Notices(Ec2Metadata(MetadataService(server.address)))


def soon(seconds: float) -> datetime:
    return datetime.now(UTC) + timedelta(seconds=seconds)


def test_ec2_without_notices(metadata):
    assert ec2(metadata).ask() == []
    assert metadata.asked[0] == "PUT /latest/api/token"


def test_ec2_announces_an_interruption_with_its_time(metadata):
    metadata.interrupt("stop", f"{soon(100):%Y-%m-%dT%H:%M:%SZ}")

    (notice,) = ec2(metadata).ask()

    assert (notice.source, notice.kind, notice.action) == ("aws", "interruption", "stop")
    assert notice.seconds_left == pytest.approx(100, abs=5)


@pytest.mark.parametrize("time", ["", "tomorrow", "2026-13-45T99:00:00Z"])
def test_an_interruption_without_a_time_that_can_be_read_comes_in_two_minutes(metadata, time):
    metadata.interrupt("terminate", time)

    (notice,) = ec2(metadata).ask()

    assert notice.seconds_left == 120.0


def test_a_time_that_is_over_leaves_nothing(metadata):
    metadata.interrupt("terminate", "2020-01-01T00:00:00Z")

    (notice,) = ec2(metadata).ask()

    assert notice.seconds_left == 0.0


def test_hibernation_begins_with_its_notice(metadata):
    metadata.interrupt("hibernate")

    (notice,) = ec2(metadata).ask()

    assert notice.seconds_left < 20.0


def test_ec2_recommends_to_move(metadata):
    metadata.answers[ADVICE] = '{"noticeTime": "2026-11-22T10:00:00Z"}'

    (notice,) = ec2(metadata).ask()

    assert notice.kind == "rebalance"
    assert notice.seconds_left is None


def test_a_group_that_terminates_the_instance_is_an_interruption(metadata):
    metadata.answers[GROUP] = "InService"
    assert ec2(metadata).ask() == []

    metadata.answers[GROUP] = "Terminated"

    (notice,) = ec2(metadata).ask()
    assert (notice.kind, notice.action) == ("interruption", "terminate")


def test_a_token_is_asked_for_once_and_again_when_it_has_expired(metadata):
    source = ec2(metadata)
    source.ask()
    source.ask()
    assert metadata.asked.count("PUT /latest/api/token") == 1

    metadata.tokens.clear()
    metadata.interrupt()

    assert len(source.ask()) == 1
    assert metadata.asked.count("PUT /latest/api/token") == 2


def test_a_service_of_the_first_version_gives_no_tokens(metadata):
    metadata.refused = 404
    metadata.interrupt()

    assert len(ec2(metadata).ask()) == 1


@pytest.mark.parametrize("status", [400, 403, 500, 503])
def test_a_service_that_refuses_tokens_has_no_notices(metadata, status):
    metadata.refused = status

    with pytest.raises(MetadataSilent, match=str(status)):
        ec2(metadata).ask()


@pytest.mark.parametrize("body", ["<html>Log in</html>", "[]", '"terminate"', "\xff"])
def test_an_answer_that_is_no_notice_takes_no_training_down(metadata, body):
    metadata.answers[SPOT] = body

    with pytest.raises(MetadataSilent):
        ec2(metadata).ask()


def test_nobody_answers():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{taken.getsockname()[1]}"

        with pytest.raises(MetadataSilent, match="does not answer"):
            Ec2Notices(Ec2Metadata(MetadataService(address))).ask()


def test_a_proxy_is_never_asked(metadata, monkeypatch):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:1")

    assert ec2(metadata).ask() == []


def test_google_preempts(metadata):
    metadata.answers[f"{GOOGLE}preempted"] = "FALSE"
    metadata.answers[f"{GOOGLE}maintenance-event"] = "NONE"
    source = GoogleNotices(MetadataService(metadata.address))
    assert source.ask() == []

    metadata.answers[f"{GOOGLE}preempted"] = "TRUE\n"

    (notice,) = source.ask()
    assert (notice.source, notice.action, notice.seconds_left) == ("gcp", "preempt", 30.0)
    assert metadata.headers[-1]["Metadata-Flavor"] == "Google"


def test_google_ends_the_machine_for_maintenance_but_not_when_it_moves_it(metadata):
    source = GoogleNotices(MetadataService(metadata.address))
    metadata.answers[f"{GOOGLE}maintenance-event"] = "MIGRATE_ON_HOST_MAINTENANCE"
    assert source.ask() == []

    metadata.answers[f"{GOOGLE}maintenance-event"] = "TERMINATE_ON_HOST_MAINTENANCE"

    assert [notice.action for notice in source.ask()] == ["terminate"]


def azure(server: MetadataServer, *events: dict[str, object]) -> AzureNotices:
    server.answers[EVENTS] = json.dumps({"DocumentIncarnation": 1, "Events": list(events)})
    server.answers[NAME] = "racer_3"
    return AzureNotices(MetadataService(server.address))


def event(kind: str, not_before: str, *names: str) -> dict[str, object]:
    return {"EventType": kind, "Resources": list(names), "NotBefore": not_before}


@pytest.mark.parametrize("kind", ["Preempt", "Terminate"])
def test_azure_takes_the_machine_away(metadata, kind):
    source = azure(metadata, event(kind, format_datetime(soon(30), usegmt=True), "racer_3"))

    (notice,) = source.ask()

    assert (notice.source, notice.kind, notice.action) == ("azure", "interruption", kind.lower())
    assert notice.seconds_left == pytest.approx(30, abs=5)


def test_an_event_of_azure_that_has_begun_leaves_no_time(metadata):
    (notice,) = azure(metadata, event("Preempt", "", "racer_3")).ask()

    assert notice.seconds_left == 0.0


def test_events_of_other_machines_freezes_and_far_reboots_are_none_of_ours(metadata):
    later = format_datetime(soon(900), usegmt=True)
    source = azure(
        metadata,
        event("Preempt", later, "racer_4"),
        event("Freeze", later, "racer_3"),
        event("Reboot", later, "racer_3"),
    )

    assert source.ask() == []


@pytest.mark.parametrize(
    "text", ["{}", '{"Events": null}', '{"Events": [null, 3, {}]}', '{"Events": "x"}']
)
def test_an_odd_list_of_events_is_empty(metadata, text):
    source = azure(metadata)
    metadata.answers[EVENTS] = text

    assert source.ask() == []


def test_the_standard_variables_name_the_service(metadata):
    metadata.interrupt()
    named = {"AWS_EC2_METADATA_SERVICE_ENDPOINT": f"{metadata.address}/"}

    source = CLOUDS["aws"].source(named, "")

    assert source is not None
    assert len(source.ask()) == 1


def test_ec2_can_be_forbidden_to_ask():
    assert CLOUDS["aws"].source({"AWS_EC2_METADATA_DISABLED": "TRUE"}, "") is None


@pytest.mark.parametrize(
    "address", ["nonsense", "http://", "http://x:99999", "ftp://x", "http://a b"]
)
def test_an_address_that_is_none_is_explained(address):
    with pytest.raises(SettingsError, match="is not the address of a metadata service"):
        CLOUDS["azure"].source({}, address)
