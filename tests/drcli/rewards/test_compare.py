"""Two functions on the same drive."""

import pytest

from drcli.rewards.compare import _report


def near(params):
    return 1.0 - params["distance_from_center"]


def test_a_function_is_like_itself(tried_of):
    report = _report(tried_of(near), tried_of(near), picture=None)

    assert report.correlation == report.rank_correlation == 1.0
    assert report.places == []
    assert all(driver.first_total == driver.second_total for driver in report.drivers)


def test_the_scale_of_a_function_does_not_matter(tried_of):
    report = _report(tried_of(near), tried_of(lambda p: 5.0 + 100.0 * near(p)), picture=None)

    assert report.correlation == pytest.approx(1.0)
    assert report.places == []


def test_opposite_wishes_are_told_with_the_places_where_they_show(tried_of):
    report = _report(tried_of(near), tried_of(lambda p: -near(p)), picture=None)

    assert report.correlation == -1.0
    assert len(report.places) == 3
    assert len({place.place.split(" driver")[0] for place in report.places}) == 3
    assert abs(report.places[0].difference) == pytest.approx(1.0, abs=0.05)


def test_who_prefers_a_fast_lap_is_told(tried_of):
    report = _report(tried_of(near), tried_of(lambda p: p["speed"] ** 3), picture=None)

    assert report.first_prefers_fast is False
    assert report.second_prefers_fast is True


def test_a_constant_function_is_like_none(tried_of):
    report = _report(tried_of(near), tried_of(lambda p: 1.0), picture=None)

    assert report.correlation is None
    assert report.rank_correlation is None
    assert report.places == []
