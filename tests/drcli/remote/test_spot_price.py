"""What the machine costs on which a training runs, as EC2 tells it."""

import threading
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from botocore.stub import ANY, Stubber

from drcli.base.errors import StorageError
from drcli.remote import spot_price
from drcli.remote.spot_price import own_spot_price
from drcli.store import profiles

SPOT = {
    "instance-type": "g4dn.2xlarge",
    "placement/availability-zone": "eu-west-1b",
    "placement/region": "eu-west-1",
    "instance-life-cycle": "spot",
}


@pytest.fixture
def metadata(monkeypatch):
    """A metadata service that wants a token; tests change what it says."""
    said = dict(SPOT)

    class Handler(BaseHTTPRequestHandler):
        def _answer(self, status, text=""):
            self.send_response(status)
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text.encode())

        def do_PUT(self):
            self._answer(200, "a-token")

        def do_GET(self):
            name = self.path.removeprefix("/latest/meta-data/")
            known = self.headers["X-aws-ec2-metadata-token"] == "a-token" and name in said
            self._answer(200 if known else 404, said.get(name, "") if known else "")

        def log_message(self, *_):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("AWS_EC2_METADATA_SERVICE_ENDPOINT", address)
    monkeypatch.delenv("AWS_EC2_METADATA_DISABLED", raising=False)
    yield said
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def ec2(monkeypatch):
    """EC2 with prepared answers."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    profiles.session_of.cache_clear()
    client = spot_price._client("eu-west-1", None)
    monkeypatch.setattr(spot_price, "_client", lambda region, profile: client)
    with Stubber(client) as stub:
        yield stub
    client.close()
    profiles.session_of.cache_clear()


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
    metadata["instance-life-cycle"] = "on-demand"

    with pytest.raises(StorageError, match=r"g4dn\.2xlarge is no spot instance") as error:
        own_spot_price()
    assert "DR_SPOT_PRICE=0.25" in error.value.remedy


def test_a_machine_outside_ec2_is_told_so(metadata):
    metadata.clear()

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
