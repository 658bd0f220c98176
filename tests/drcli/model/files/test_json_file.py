"""The lines of values in a JSON file."""

import json

from hypothesis import given
from hypothesis import strategies as st

from drcli.model.files.data_file import read_json_object

TEXTS = st.text(max_size=4) | st.sampled_from(['"', "\\", "a:b", "{", "x,y]", "é\n"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)


def paths(value, path=()):
    """The path of each value inside another one."""
    yield path
    if isinstance(value, dict | list):
        keys = value if isinstance(value, dict) else range(len(value))
        for key in keys:
            yield from paths(value[key], (*path, key))


@given(st.dictionaries(TEXTS, VALUES, max_size=4))
def test_every_value_has_a_line_and_lines_grow_in_the_order_of_the_file(values):
    file = read_json_object(json.dumps(values, indent=1).encode(), "x.json", "V-04")

    assert file.values == values
    assert list(file.lines) == list(paths(values))
    assert list(file.lines.values()) == sorted(file.lines.values())


def test_a_value_is_placed_in_its_own_line_or_in_that_of_what_is_around_it():
    file = read_json_object(b'{\n"a": [1,\n {"b":\n 2}]\n}', "x.json", "V-04")

    lines = [
        file.problem("V-04", path, "It is wrong.", "").line
        for path in ((), ("a",), ("a", 1), ("a", 1, "b"), ("a", 1, "missing"))
    ]

    assert lines == [None, 2, 3, 4, 3]
