"""The droa commands from the command line to a fake DeepRacer on AWS and back."""

import json

import pytest

from droa_server import PASSWORD, USER


def test_a_list_shows_all_pages_and_the_newest_model_first(droa, fake, capsys):
    for name in ("first", "second", "third", "fourth", "fifth"):
        fake.add_model(name)

    code = droa("droa-list-models")

    printed = capsys.readouterr().out.splitlines()
    assert code == 0
    assert [line.split()[0] for line in printed[2:]] == [
        "fifth", "fourth", "third", "second", "first"
    ]  # fmt: skip
    assert len([call for call in fake.calls if call[0] == "GET"]) == 3
