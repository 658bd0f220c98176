"""Errors of requests as sentences, and requests that no page sends."""

import json
from typing import Annotated

import pytest
from pydantic import ConfigDict, Field
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from drcli.base.errors import (
    BudgetUsedUp,
    NotAvailable,
    SettingsError,
    StorageError,
    TrainedElsewhere,
)
from drcli.web.answers import (
    MOST_BYTES,
    MOST_DEPTH,
    BadRequest,
    Body,
    Text,
    accepts,
    answers,
    known,
)


class Anything(Body):
    model_config = ConfigDict(extra="allow")


class Named(Body):
    name: Text
    laps: Annotated[int, Field(ge=1)] = 3
    take: Annotated[list[str], known(("a.py", "b.py"))] = Field(default_factory=list)


def echo(_: Request, body: Anything):
    return body.model_dump()


def asked(function, **request):
    app = Starlette(routes=[Route("/", answers(function))])
    return TestClient(app).get("/", **request)


def posted(content, function=echo):
    app = Starlette(routes=[Route("/", accepts(function), methods=["POST"])])
    return TestClient(app).post("/", content=content)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (SettingsError("It is wrong.", remedy="Correct it."), 422),
        (StorageError("It is away.", remedy="Start it."), 503),
        (NotAvailable("It is missing.", remedy="Install it."), 501),
        (TrainedElsewhere("It is taken.", remedy="Wait."), 409),
        (BudgetUsedUp("It is spent.", remedy="Wait."), 409),
    ],
)
def test_an_error_is_one_sentence_with_a_remedy_and_a_code(error, status):
    def fail(_):
        raise error

    answer = asked(fail)

    assert answer.status_code == status
    assert answer.json() == {
        "error": {"message": str(error), "remedy": error.remedy, "code": error.code}
    }


def test_a_fault_of_the_program_shows_no_traceback(logged):
    def fail(_):
        return {}["missing"]

    answer = asked(fail)

    assert answer.status_code == 500
    assert "Traceback" not in answer.text
    assert "viewer.log" in answer.json()["error"]["remedy"]
    assert "Traceback" in logged()


def test_answers_are_plain_json_or_what_the_route_made():
    assert asked(lambda _: {"a": float("nan")}).json() == {"a": None}
    assert asked(lambda _: PlainTextResponse("file")).text == "file"


def test_a_request_with_an_object_is_taken():
    assert posted(b'{"a": [1, 2]}').json() == {"a": [1, 2]}
    assert posted(b"").json() == {}


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b"1",
        b'"text"',
        b"null",
        b"{",
        b"\xff\xfe",
        b"\x00",
        b"[" * 100_000,
        b'{"a":' * 2000 + b"1" + b"}" * 2000,
        json.dumps({"a": [[[[[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]]]]]}).encode(),
    ],
)
def test_anything_else_is_refused(content):
    answer = posted(content)

    assert answer.status_code == 400
    assert "JSON" in answer.json()["error"]["message"]


def test_what_is_nested_as_deeply_as_allowed_is_taken():
    value = 1
    for _ in range(MOST_DEPTH - 1):
        value = [value]

    assert posted(json.dumps({"a": value}).encode()).status_code == 200


def test_a_large_request_is_refused_before_it_is_read_to_its_end():
    taken = []

    def endless():
        while True:
            taken.append(1)
            yield b" " * 65_536

    def limited():
        for _, part in zip(range(200), endless(), strict=False):
            yield part

    answer = posted(limited())

    assert answer.status_code == 413
    assert answer.json()["error"]["message"] == f"The request is larger than {MOST_BYTES >> 20} MB."


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({}, "The request needs name."),
        ({"name": 1}, "name=1 should be a valid string."),
        ({"name": None}, "name=null should be a valid string."),
        ({"name": "a\0b"}, 'name="a\\u0000b" has a character that no text may have.'),
        ({"name": "a", "laps": 0}, "laps=0 should be greater than or equal to 1."),
        ({"name": "a", "laps": True}, "laps=true should be a valid integer."),
        ({"name": "a", "take": ["c.py"]}, 'take=["c.py"] has c.py, which is not one of them.'),
    ],
)
def test_a_wrong_value_is_refused_with_its_key_and_a_remedy(body, said):
    with pytest.raises(BadRequest) as refused:
        Named.read(body)

    assert str(refused.value) == said
    assert refused.value.remedy


def test_a_body_has_usual_values_and_no_others():
    assert Named.read({"name": "a", "new": 1}).model_dump() == {"name": "a", "laps": 3, "take": []}


def test_what_a_reader_of_a_route_gets_is_the_request():
    assert asked(lambda request: {"path": Request(request.scope).url.path}).json() == {"path": "/"}
