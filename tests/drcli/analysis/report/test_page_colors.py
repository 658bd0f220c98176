"""Everybody can see the lines on the map and read the texts, in light and in dark."""

import re
from importlib.resources import files

import pytest

CSS = files("drcli.web").joinpath("pages/colors.css").read_text("utf-8")
THEMES = dict(
    zip(
        ("light", "dark"),
        (dict(re.findall(r"--([\w-]+): (#\w{6});", css)) for css in CSS.split("data-theme")),
        strict=True,
    )
)


def contrast(first: str, second: str) -> float:
    """Contrast ratio of two colours, 1 to 21. Source: WCAG 2.1."""
    dark, light = sorted((luminance(first), luminance(second)))
    return (light + 0.05) / (dark + 0.05)


def luminance(color: str) -> float:
    parts = (int(color[at : at + 2], 16) / 255 for at in (1, 3, 5))
    linear = (
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    )
    return sum(share * part for share, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("theme", THEMES)
def test_laps_and_ends_stand_out_from_the_road_and_the_ground(theme):
    colors = THEMES[theme]
    drawn = {name for name in colors if re.fullmatch(r"(lap|fast|worst|end)\d", name)}

    assert len(drawn) == 8 + 5 + 5 + 5
    for name in sorted(drawn):
        for ground in ("road", "raised"):
            assert contrast(colors[name], colors[ground]) >= 3.0, (name, ground)


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("ground", ["paper", "raised"])
def test_texts_can_be_read(theme, ground):
    colors = THEMES[theme]

    for name in ("ink", "quiet", "accent", "good", "bad", *(f"c{n}" for n in range(1, 9))):
        assert contrast(colors[name], colors[ground]) >= 4.5, name
