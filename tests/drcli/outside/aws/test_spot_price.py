"""What the machine costs on which a training runs, as EC2 tells it."""

from collections.abc import Iterator
from datetime import UTC, datetime

import pytest
from botocore.stub import ANY, Stubber

from drcli.base.errors import StorageError
from drcli.bucket import endpoint
from drcli.outside.aws import prices
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.prices import own_spot_price
from metadata_server import MetadataServer

SPOT = {
    "instance-type": "g4dn.2xlarge",
    "placement/availability-zone": "eu-west-1b",
    "placement/region": "eu-west-1",
    "instance-life-cycle": "spot",
}


@pytest.fixture
def metadata(monkeypatch: pytest.MonkeyPatch) -> Iterator[MetadataServer]:
    """The metadata service of a spot instance; tests change what it says."""
    with MetadataServer() as server:
        server.describe(SPOT)
        monkeypatch.setenv("AWS_EC2_METADATA_SERVICE_ENDPOINT", server.address)
        monkeypatch.delenv("AWS_EC2_METADATA_DISABLED", raising=False)
        yield server


@pytest.fixture
def ec2(monkeypatch):
    """EC2 with prepared answers."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    endpoint.session_of.cache_clear()
    account = Account("eu-west-1", None)
    client = account.client("ec2")
    monkeypatch.setattr(prices, "Account", lambda *_, **__: account)
    with Stubber(client) as stub:
        yield stub
    client.close()
    endpoint.session_of.cache_clear()


WANTED = {
    "InstanceTypes": ["g4dn.2xlarge"],
    "AvailabilityZone": "eu-west-1b",
    "ProductDescriptions": ["Linux/UNIX"],
    "StartTime": ANY,
    "MaxResults": 1,
}


def test_the_price_is_that_of_the_type_in_its_zone(metadata, ec2):
    entry = {"SpotPrice": "0.2210", "Timestamp": datetime.now(UTC)}
    ec2.add_response("describe_spot_price_history", {"SpotPriceHistory": [entry]}, WANTED)

    found = own_spot_price()

    assert found.usd_per_hour == 0.221
    assert found.place == "g4dn.2xlarge in eu-west-1b"


def test_an_ordinary_machine_has_no_spot_price(metadata):
    metadata.describe({"instance-life-cycle": "on-demand"})

    with pytest.raises(StorageError, match=r"g4dn\.2xlarge is no spot instance") as error:
        own_spot_price()
    assert "DR_SPOT_PRICE=0.25" in error.value.remedy


def test_a_machine_outside_ec2_is_told_so(metadata):
    metadata.answers.clear()

    with pytest.raises(StorageError, match="no metadata service of EC2"):
        own_spot_price()


def test_a_missing_permission_is_told(metadata, ec2):
    ec2.add_client_error("describe_spot_price_history", "UnauthorizedOperation", "No.")

    with pytest.raises(StorageError, match="does not tell the spot price"):
        own_spot_price()


def test_a_type_without_a_spot_price_is_told(metadata, ec2):
    ec2.add_response("describe_spot_price_history", {"SpotPriceHistory": []}, WANTED)

    with pytest.raises(StorageError, match="knows no spot price"):
        own_spot_price()
