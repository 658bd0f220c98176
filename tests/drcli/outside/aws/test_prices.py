"""Prices, interruptions, quotas and costs."""

import json
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest
from botocore.stub import Stubber

from drcli.base.errors import SettingsError, StorageError
from drcli.base.json_record import RecordError
from drcli.outside.aws import instance_types
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.instance_types import ARM_TYPES, X86_TYPES, InstanceType, find_types
from drcli.outside.aws.machines import at_prices
from drcli.outside.aws.prices import (
    ADDRESS_VARIABLE,
    Offer,
    advisor_of,
    arranged,
    current_prices,
    on_demand_prices,
    read_advisor,
)

START = datetime(2026, 5, 1, tzinfo=UTC)
SMALL = InstanceType("c7i.xlarge", "x86_64", 4, 8192)
LARGE = InstanceType("c7i.2xlarge", "x86_64", 8, 16384)
ADVICE = {
    "spot_advisor": {
        "us-east-1": {"Linux": {"c7i.xlarge": {"r": 0, "s": 70}, "m7i.xlarge": {"r": 4}}},
        "eu-west-1": {
            "Linux": {"c7i.xlarge": {"r": 9}, "x": 3},
            "Windows": {"c7i.xlarge": {"r": 1}},
        },
        "odd": [],
    }
}


def offer(name: str, usd: float, workers: int, seen: str = "", region: str = "us-east-1") -> Offer:
    return Offer(name, region, region + "a", usd, workers, seen)


def test_each_key_sorts():
    offers = [
        offer("b", 0.2, 4, ">20%"),
        offer("a", 0.1, 1, "<5%", "eu-west-1"),
        offer("c", 0.3, 9),
    ]

    def order(key):
        return "".join(each.type for each in arranged(offers, key, None))

    assert order("SpotPrice") == "abc"
    assert order("PricePerWorkerHour") == "cba"
    assert order("NumberOfWorkers") == "abc"
    assert order("InterruptionFrequency") == "abc"
    assert order("Region") == "acb"
    assert order("InstanceType") == "abc"


def test_the_filter_leaves_out_unknown_interruptions_too():
    offers = [offer("a", 0.1, 1, "<5%"), offer("b", 0.1, 1, ">20%"), offer("c", 0.1, 1)]

    kept = arranged(offers, "InstanceType", {"<5%", "5-10%"})

    assert [each.type for each in kept] == ["a"]


def test_the_advisor_is_read_and_odd_entries_are_left_out():
    advisor = advisor_of(ADVICE)

    assert advisor["us-east-1", "c7i.xlarge"] == "<5%"
    assert advisor["us-east-1", "m7i.xlarge"] == ">20%"
    assert ("eu-west-1", "c7i.xlarge") not in advisor


@pytest.mark.parametrize("content", [None, [], {}, {"spot_advisor": 3}, {"spot_advisor": {"a": 1}}])
def test_an_advisor_without_machines_is_refused(content):
    with pytest.raises(RecordError):
        advisor_of(content)


@pytest.mark.parametrize("body", [json.dumps(ADVICE).encode(), b"{", b"\xff\xfe"])
def test_the_advisor_may_stand_at_another_address(monkeypatch, body):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: object) -> None:
            """Print nothing."""

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.handle_request)
    thread.start()
    monkeypatch.setenv(ADDRESS_VARIABLE, f"http://127.0.0.1:{server.server_port}/x.json")
    try:
        if body.startswith(b'{"'):
            assert read_advisor().values
        else:
            with pytest.raises(StorageError, match="cannot be read"):
                read_advisor()
    finally:
        thread.join()
        server.server_close()


def test_an_advisor_that_cannot_be_reached_is_explained(monkeypatch):
    monkeypatch.setenv(ADDRESS_VARIABLE, "http://127.0.0.1:1/x.json")

    with pytest.raises(StorageError, match="How often machines are interrupted is not known"):
        read_advisor()


def test_spot_prices_come_by_type_and_zone(amazon):
    found = current_prices(amazon, ["c7i.xlarge"])

    assert ("c7i.xlarge", "us-east-1a") in found
    assert {name for name, _ in found} == {"c7i.xlarge"}


def test_all_default_types_are_large_enough_and_of_their_architecture(amazon):
    x86 = find_types(amazon, X86_TYPES, named=False)
    arm = find_types(amazon, ARM_TYPES, named=False)

    assert {each.architecture for each in x86} == {"x86_64"}
    assert {each.architecture for each in arm} == {"arm64"}
    assert {each.threads for each in (*x86, *arm)} <= {4, 8}


def test_default_types_that_a_region_lacks_are_left_out(amazon):
    found = find_types(amazon, ["c7i.xlarge", "c99.huge"], named=False)

    assert [each.name for each in found] == ["c7i.xlarge"]


@pytest.fixture
def stubbed(keys):
    """Answers of services that moto does not play."""
    account = Account("us-east-1", None)
    stubs = {}

    def stub(service: str, region: str = "") -> Stubber:
        stubs[service] = Stubber(account.client(service, region))
        stubs[service].activate()
        return stubs[service]

    yield account, stub
    for each in stubs.values():
        each.assert_no_pending_responses()
        each.deactivate()


def test_prices_of_ordinary_machines_are_read_from_the_price_list(stubbed):
    account, stub = stubbed
    term = {"unit": "Hrs", "pricePerUnit": {"USD": "0.1785000000"}}
    free = {"unit": "Hrs", "pricePerUnit": {"USD": "0.0000000000"}}
    products = [
        {"terms": {"OnDemand": {"a": {"priceDimensions": {"b": free}}}}},
        {"terms": {"OnDemand": {"a": {"priceDimensions": {"b": term}}}}},
        {"terms": {}},
    ]
    answer = {"PriceList": [*map(json.dumps, products), "not json"]}
    stub("pricing", "us-east-1").add_response("get_products", answer)

    assert on_demand_prices(account, ["c7i.xlarge"]) == {"c7i.xlarge": 0.1785}


def answers_of_quotas(stub, limit: float, running: list[dict]) -> None:
    stub("service-quotas").add_response("get_service_quota", {"Quota": {"Value": limit}})
    stub("ec2").add_response("describe_instances", {"Reservations": [{"Instances": running}]})


def running(kind: str, threads: int, **more: str) -> dict:
    cores = {"CoreCount": threads // 2, "ThreadsPerCore": 2}
    return {"InstanceType": kind, "CpuOptions": cores, **more}


def test_types_that_the_quota_forbids_are_left_out(stubbed):
    account, stub = stubbed
    others = [
        running("m5.xlarge", 4, InstanceLifecycle="spot"),
        running("m5.24xlarge", 96),
        running("g5.xlarge", 4, InstanceLifecycle="spot"),
    ]
    answers_of_quotas(stub, 8.0, others)

    types, notes = instance_types.check_quotas(account, [SMALL, LARGE], spot=True)

    assert types == [SMALL]
    assert "L-34B43A08 allows 8 vCPUs" in notes[0]
    assert "4 are used" in notes[0]


def test_a_quota_that_allows_nothing_is_an_error_with_the_place_to_ask(stubbed):
    account, stub = stubbed
    answers_of_quotas(stub, 0.0, [])

    with pytest.raises(SettingsError, match="L-1216C47A allows 0 vCPUs") as caught:
        instance_types.check_quotas(account, [SMALL], spot=False)

    assert "servicequotas" in caught.value.remedy


def test_a_quota_that_may_not_be_read_is_only_a_warning(stubbed):
    account, stub = stubbed
    said = "User: me is not authorized to perform: servicequotas:GetServiceQuota because no"
    stub("service-quotas").add_client_error("get_service_quota", "AccessDeniedException", said, 400)

    types, notes = instance_types.check_quotas(account, [SMALL], spot=True)

    assert types == [SMALL]
    assert "servicequotas:GetServiceQuota" in notes[0]


def test_cost_follows_the_history_of_the_price():
    def price(usd: str, hours: float) -> dict:
        return {"SpotPrice": usd, "Timestamp": START + timedelta(hours=hours)}

    history = [price("0.4", 3.0), price("0.1", -5.0), price("0.2", 1.0)]

    assert at_prices(history, START, START + timedelta(hours=4)) == pytest.approx(0.1 + 0.4 + 0.4)
    assert at_prices(history[:1], START, START + timedelta(hours=2)) == pytest.approx(0.8)
    assert at_prices([], START, START) is None
