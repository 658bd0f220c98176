"""What travels between the sandbox and its parent comes back as it was, or is refused."""

import json

import pytest

from drcli.base.errors import Problem
from drcli.base.json_record import RecordError
from drcli.rewards.sandbox.run_sandbox import (
    CallIndex,
    Difference,
    Effect,
    Failure,
    Printed,
    SandboxRequest,
    SandboxResult,
    Timing,
    read_course,
    write_course,
)

RESULT = SandboxResult(
    problems=[Problem("V-05", "error", "run.env", 1, "No such track.", "Correct it.")],
    values=[[1.0, None], []],
    failures=[
        Failure("raises", "KeyError: 'a'", 3, "return params['a']", "on the road", "{}", times=2)
    ],
    returned={"float": 1},
    line=2,
    timing=Timing(0.1, 0.2, 0.3, CallIndex(0, 0)),
    calls=2,
    counted=1,
    effects=[Effect("writes", "log.txt", 4, 2)],
    printed=Printed(1, 5, 3),
    random=Difference(CallIndex(0, 0), 1.0, None, 1, 2),
)


def test_a_result_comes_back_as_it_was(tmp_path):
    RESULT.write(tmp_path)

    assert SandboxResult.read(tmp_path) == RESULT


def test_a_request_comes_back_as_it_was(tmp_path):
    request = SandboxRequest(
        "mine.py", [[{"speed": 1.0}]], [[(0.0, 1.0)], []], 1, None, True, metadata="{}", call_s=0.5
    )
    request.write(tmp_path)

    assert SandboxRequest.read(tmp_path) == request


def test_a_race_to_drive_comes_back_as_it_was(tmp_path, settings_of):
    request = SandboxRequest("mine.py", drive=settings_of().race)
    request.write(tmp_path)

    assert SandboxRequest.read(tmp_path) == request


def test_a_course_comes_back_as_it_was(tmp_path, course):
    write_course(course.course, tmp_path)

    assert read_course(tmp_path) == course.course


def test_without_a_result_there_is_none(tmp_path):
    assert SandboxResult.read(tmp_path) is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format": 1}, "its format is 1, not 2"),
        ({"values": "many"}, r"at `\$\.values`"),
        ({"failures": [{"kind": "tired"}]}, r"at `\$\.failures\[0\]\.kind`"),
    ],
)
def test_a_foreign_result_is_refused_with_a_reason(tmp_path, change, reason):
    RESULT.write(tmp_path)
    [file] = tmp_path.iterdir()
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))

    with pytest.raises(RecordError, match=reason):
        SandboxResult.read(tmp_path)
