"""What is said of a server."""

from drcli.bucket.endpoint import Endpoint


def test_a_password_in_an_address_is_not_repeated():
    endpoint = Endpoint("http://racer:geheim@192.168.1.5:9000")

    assert endpoint.place == "http://192.168.1.5:9000"


def test_an_address_without_one_is_told_as_it_is():
    assert Endpoint("https://s3.example.org").place == "https://s3.example.org"


def test_amazon_is_told_by_its_region():
    assert Endpoint(None, region="eu-central-1").place == "Amazon S3 (eu-central-1)"
