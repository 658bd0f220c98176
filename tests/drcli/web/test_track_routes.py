"""Lines of tracks for maps."""

import pytest


def test_a_track_has_three_lines_in_metres(client):
    track = client.get("/api/track?world=reinvent_base").json()

    assert track["closed"]
    assert 17 < track["length_m"] < 18.5
    assert all(len(track[name]) > 50 for name in ("center", "inner", "outer"))


@pytest.mark.parametrize("world", ["", "../../etc/passwd", "a/b", "x" * 200, ".hidden"])
def test_what_is_no_name_is_refused(client, world):
    answer = client.get("/api/track", params={"world": world})

    assert answer.status_code == 400
    assert "is not a name of a track" in answer.json()["error"]["message"]


def test_a_track_that_is_not_installed_is_a_sentence(client):
    answer = client.get("/api/track?world=nowhere")

    assert answer.status_code == 422
    assert "nowhere" in answer.json()["error"]["message"]
    assert answer.json()["error"]["remedy"]


def test_the_fastest_line_of_the_car_is_told_in_both_directions(client):
    lines = [
        client.get(f"/api/track/limit?world=reinvent_base&reverse={reverse}").json()
        for reverse in ("false", "true")
    ]

    assert [each["reverse"] for each in lines] == [False, True]
    assert all(len(each["line"]) > 50 for each in lines)
    assert "reinvent_base" in lines[0]["text"]


def test_a_track_whose_line_is_not_known_is_told(client):
    answer = client.get("/api/track/limit?world=nowhere")

    assert answer.status_code >= 400
    assert "nowhere" in answer.json()["error"]["message"]
