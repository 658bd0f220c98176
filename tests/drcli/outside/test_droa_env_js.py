"""env.js in every spelling that a deployment could write."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.outside.droa.droa_site import NotEnvJs, read_env_js

WANTED = {"region": "us-east-1", "apiEndpointUrl": "https://a.example/prod/"}


@pytest.mark.parametrize(
    "script",
    [
        f"window.EnvironmentConfig = {json.dumps(WANTED)};",
        f"window.EnvironmentConfig={json.dumps(WANTED)}",
        f'window["EnvironmentConfig"] = {json.dumps(WANTED, indent=2)};',
        f"\ufeffconst env = {json.dumps(WANTED)}\n        window.EnvironmentConfig = env;",
        "window.EnvironmentConfig = {region: 'us-east-1', apiEndpointUrl: `https://a.example/prod/`,}",
        "window.EnvironmentConfig = { // a comment with } and '\n"
        ' "region": /* here */ "us-east-1",\n'
        "  apiEndpointUrl: 'https://' + \"a.example\" + '/prod/',\n};",
        f"window.EnvironmentConfig = JSON.parse('{json.dumps(WANTED)}');",
        f"window.EnvironmentConfig = Object.freeze({json.dumps(WANTED)});",
        "self.x = 1; globalThis.EnvironmentConfig = {nested: {region: 'no', list: [1, {a: 2}]},\n"
        "number: 5, none: null, region: 'us\\x2deast\\u002d1', "
        "apiEndpointUrl: 'https:\\/\\/a.example\\/prod/'}; window.other = {region: 'no'};",
    ],
)
def test_every_way_to_write_it_gives_the_same(script):
    assert read_env_js(script) == WANTED


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("<!doctype html><html></html>", "a web page"),
        ("", "does not set EnvironmentConfig"),
        ("window.env = {region: 'x'};", "does not set EnvironmentConfig"),
        ("window.EnvironmentConfig = 5;", "which it does not define"),
        ("window.EnvironmentConfig = ;", "not an object"),
        ("window.EnvironmentConfig = other;", "other, which it does not define"),
        ("window.EnvironmentConfig = {region: 'x'", "not complete"),
        ("window.EnvironmentConfig = JSON.parse('[1]');", "not an object"),
        ("window.EnvironmentConfig = 'text", "not an object"),
    ],
)
def test_something_else_is_named(script, words):
    with pytest.raises(NotEnvJs, match=words):
        read_env_js(script)


def test_a_variable_of_itself_ends():
    with pytest.raises(NotEnvJs):
        read_env_js("EnvironmentConfig = EnvironmentConfig;")


def test_texts_with_values_inside_are_left_out():
    assert read_env_js("EnvironmentConfig = {region: `${x}`, b: 'c' + d, e: 'f'}") == {"e": "f"}


@given(st.text(alphabet="{}[]()'\"`\\/*=,:+;. \nEnvironmentConfigx1", max_size=80))
def test_no_text_breaks_the_reader(text):
    try:
        found = read_env_js(f"window.EnvironmentConfig = {text}")
    except NotEnvJs:
        return
    assert all(isinstance(value, str) for value in found.values())


@given(st.dictionaries(st.text(max_size=10), st.text(max_size=20), max_size=5))
def test_any_json_is_read_back(values):
    assert read_env_js(f"window.EnvironmentConfig = {json.dumps(values)};") == values
