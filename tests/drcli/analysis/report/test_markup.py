"""Elements of HTML, and that nothing in a text becomes one."""

import pytest

from drcli.analysis.report.markup import Html, bar, element, escaped, table


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("<script>alert(1)</script>", "&lt;script&gt;alert(1)&lt;/script&gt;"),
        ('" onclick="x', "&quot; onclick=&quot;x"),
        ("a & b", "a &amp; b"),
        ("\x00\x1b[31m\u202etxt", "\ufffd\ufffd[31m\ufffdtxt"),
    ],
)
def test_text_stays_text(text, html):
    assert escaped(text) == html
    assert element("p", text) == f"<p>{html}</p>"
    assert element("p", title=text) == f'<p title="{html}"></p>'


def test_html_is_escaped_once():
    assert escaped(escaped("<")) == "&lt;"
    assert element("div", element("b", "<"), None) == "<div><b>&lt;</b></div>"


def test_attributes_without_a_value_are_there_or_not():
    assert element("input", checked=True, hidden=False, class_="a") == '<input checked class="a">'
    assert element("td", aria_label="x") == '<td aria-label="x"></td>'


def test_a_table_has_a_caption_and_aligns_its_numbers():
    html = table("Laps", ["lap", "time"], [["<1>", "12.3"]])

    assert "<caption>Laps</caption>" in html
    assert '<td>&lt;1&gt;</td><td class="number">12.3</td>' in html
    assert '<th scope="col">lap</th>' in html


@pytest.mark.parametrize(("part", "width"), [(-1.0, "0.0%"), (0.25, "25.0%"), (7.0, "100.0%")])
def test_a_bar_stays_within_its_room(part, width):
    assert isinstance(bar(part), Html)
    assert f'width="{width}" height="100%" class="part"' in bar(part)
