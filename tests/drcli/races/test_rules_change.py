"""Other rules for a race, as long as nobody has driven under the old ones."""

from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError
from drcli.races.organise import change_rules, options_of
from drcli.races.race_options import RaceOptions, rules_of
from drcli.races.stored_race import read_rules

from .conftest import RACE


@pytest.mark.parametrize("ranking", ["best-lap", "best-average", "total-time"])
def test_options_made_of_rules_leads_to_the_same_rules(home, ranking):
    options = RaceOptions(
        "Cup", ranking=ranking, max_laps=4, closes_at=99.0, sensors=("LIDAR",), seed=2
    )
    rules = rules_of(home.settings, options, 1.0)

    assert rules_of(home.settings, options_of(rules), 1.0) == rules


def test_what_follows_from_other_rules_follows_again(home):
    home.race(ranking="total-time")
    options = replace(options_of(read_rules(home.bucket, RACE)), max_laps=6)
    rules = change_rules(home.settings, home.bucket, RACE, options).rules

    assert (rules.min_laps, rules.average_laps) == (6, 3)


def test_another_kind_of_race_has_its_own_settings_and_a_wrong_rule_changes_nothing(home):
    home.race(race_type="HEAD_TO_MODEL")
    before = read_rules(home.bucket, RACE)
    assert not any("_START_" in name for name in before.settings)
    options = options_of(before)
    with pytest.raises(SettingsError, match="--laps 0"):
        change_rules(home.settings, home.bucket, RACE, replace(options, max_laps=0))
    assert read_rules(home.bucket, RACE) == before

    changed = change_rules(
        home.settings, home.bucket, RACE, replace(options, race_type="TIME_TRIAL")
    )
    assert any("_START_" in name for name in changed.rules.settings)
