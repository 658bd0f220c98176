"""Addresses, networks and answers that are wrong: one sentence each, exit code 3 or 4."""

import json
import socket

import pytest

from drcli.outside.droa.droa_site import SiteOptions, find_site
from drcli.outside.web_request import Web


@pytest.fixture
def failed(droa, capsys):
    """Runs a command that must fail; its code, sentence and remedy."""

    def run(*words):
        code = droa(*words)
        printed = capsys.readouterr()
        assert printed.out == ""
        assert "Traceback" not in printed.err
        errors = [line for line in printed.err.splitlines() if line.startswith("Error: ")]
        remedies = [line for line in printed.err.splitlines() if line.startswith("  Try: ")]
        assert len(errors) == len(remedies) == 1
        return code, errors[0], remedies[0]

    return run


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("http://droa.example.com", "is not protected"),
        ("ftp://droa.example.com", "is not the address of a web page"),
        ("https://", "is not the address of a web page"),
        ("https://a b.example", "is not the address of a web page"),
        ("https://[::1", "is not the address of a web page"),
        ("https://a.example:port", "is not the address of a web page"),
        ("https://me:secret@droa.example.com", "contains a user name or password"),
    ],
)
def test_a_wrong_address_is_refused(failed, url, words):
    code, error, _ = failed("droa-list-models", "--url", url)

    assert code == 3
    assert words in error
    assert "secret" not in error


@pytest.mark.parametrize("ending", ["", "/", "/env.js", "/index.html", "//"])
def test_what_a_browser_adds_to_an_address_is_left_out(fake, ending):
    site = find_site(SiteOptions(url=fake.url + ending), "", "", Web("--url"))

    assert site.url == fake.url
    assert site.api_endpoint == f"{fake.url}/prod"
    assert site.upload_bucket == "upload-bucket"


def test_a_host_name_that_cannot_be_one_is_told(failed):
    code, error, _ = failed("droa-list-models", "--url", "https://" + 200 * "x" + ".example.com")

    assert code == 4
    assert "is not a web address" in error


def test_a_server_that_does_not_run_is_named(failed, pauses):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    code, error, remedy = failed("droa-list-models", "--url", f"http://127.0.0.1:{port}")

    assert code == 4
    assert f"127.0.0.1:{port} cannot be reached: it refuses the connection" in error
    assert "--url" in remedy
    assert len(pauses) == 3


def test_a_server_without_tls_is_named_at_once(failed, fake, pauses):
    code, error, _ = failed("droa-list-models", "--url", f"https://{fake.host}")

    assert code == 4
    assert "certificate" in error
    assert pauses == []


def test_a_page_without_env_js_is_named(failed, fake):
    code, error, remedy = failed("droa-list-models", "--url", f"{fake.url}/elsewhere")

    assert code == 4
    assert "/elsewhere/env.js cannot be read: the server answered 404" in error
    assert "--url" in remedy


def test_another_web_page_is_no_configuration(failed, fake):
    fake.env_js = "<html>Welcome</html>"

    code, error, _ = failed("droa-list-models")

    assert code == 4
    assert "is not the configuration of a DeepRacer on AWS: it is a web page" in error


def test_a_value_that_env_js_lacks_can_be_given(failed, droa, fake):
    fake.env_js = fake.env_js.replace("uploadBucketName", "somethingElse")

    code, error, remedy = failed("droa-list-models")

    assert code == 4
    assert "lacks uploadBucketName" in error
    assert "--upload-bucket" in remedy
    assert droa("droa-list-models", "--upload-bucket", "mine") == 0


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("eu-west-1', upload", "evil.com/#', upload", "is not an AWS region"),
        ("http://127.0.0.1", "http://api.example.com", "is not protected"),
        ("http://127.0.0.1", "javascript:", "is not a web address"),
    ],
)
def test_values_that_lead_elsewhere_are_refused(failed, fake, before, after, words):
    fake.env_js = fake.env_js.replace(before, after)

    code, error, _ = failed("droa-list-models")

    assert code == 3
    assert words in error
    assert fake.sign_ins == 0


JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize(
    ("status", "headers", "body", "words"),
    [
        (400, JSON, b'{"message": "Total number of models exceeded."}', "400: Total number"),
        (403, JSON, b'{"Message": "User is not authorized"}', "403: User is not authorized"),
        (403, {}, b"<html>blocked</html>", "403: Forbidden"),
        (404, {}, b"", "404: Not Found"),
        (302, {"Location": "https://login.example"}, b"", "is not the interface"),
        (200, {}, b"<html>page</html>", "is not the interface"),
        (200, JSON, b"[]", "is not the interface"),
        (200, JSON, b"{}", "an answer without models"),
        (200, JSON, b'{"models": 5}', "an answer without models"),
        (200, JSON, b'{"models": [{"name": "x"}]}', "a model without an id"),
        (200, JSON, b'{"models": [5]}', "a model without an id"),
        (200, JSON, b"\xff{", "is not the interface"),
        (200, JSON, b"[" * 100_000, "is not the interface"),
    ],
)
def test_an_answer_that_is_wrong_is_one_sentence(failed, fake, status, headers, body, words):
    fake.faults = [(status, headers, body)]

    code, error, _ = failed("droa-list-models")

    assert code == 4
    assert words in error


def test_long_and_odd_messages_are_shortened(failed, fake):
    fake.faults = [(400, JSON, json.dumps({"message": "line\n" * 1000}).encode())]

    _, error, _ = failed("droa-list-models")

    assert len(error) < 500


@pytest.mark.parametrize("fault", [(503, {}, b""), (429, {}, b""), (500, {}, b""), None])
def test_reading_is_repeated_after_a_passing_trouble(droa, fake, pauses, fault):
    fake.faults = [fault, fault]

    assert droa("droa-list-models") == 0
    assert pauses == [0.5, 1.0]


def test_a_trouble_that_stays_is_said(failed, fake, pauses):
    fake.faults = [None] * 10

    code, error, _ = failed("droa-list-models")

    assert code == 4
    assert "closed the connection" in error
    assert len(fake.calls) == 4


@pytest.mark.parametrize("fault", [(503, JSON, b'{"message": "busy"}'), None])
def test_an_import_is_never_asked_for_twice(failed, fake, laid, model, fault):
    fake.faults = [fault]

    code, _, _ = failed("droa-import-model", "--from", str(laid(model)))

    assert code == 4
    assert [method for method, _ in fake.calls] == ["POST"]


def test_a_list_of_pages_without_end_ends(droa, fake):
    page = (200, JSON, b'{"models": [], "token": "again"}')
    fake.faults = [page] * 5

    assert droa("droa-list-models") == 0
    assert len(fake.calls) == 2


def test_requests_say_who_asks_and_from_which_page(droa, fake):
    droa("droa-list-models")

    headers = fake.headers[0]
    assert headers["User-Agent"].startswith("drcli/")
    assert headers["Origin"] == fake.url
    assert headers["Referer"] == f"{fake.url}/"
