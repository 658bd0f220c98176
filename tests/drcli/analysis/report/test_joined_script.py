"""Modules of the pages become one script."""

import pytest

from drcli.analysis.report import joined_script as joining
from drcli.analysis.report.joined_script import joined_script


def joined(monkeypatch, **modules: str) -> str:
    monkeypatch.setattr(joining, "page_file", lambda name: modules[name.removesuffix(".js")])
    return joined_script("/a.js")


def test_a_module_comes_once_and_after_those_that_it_needs(monkeypatch):
    text = joined(
        monkeypatch,
        a='import { one as uno } from "/b.js";\nimport {\n  two,\n} from "/c.js";\n\nuno(two);\n',
        b='import { two } from "/c.js";\nimport * as all from "/d.js";\n\n'
        "export function one() {}\nexport const other = two;\n",
        c='export * from "/d.js";\nexport class two {}\n',
        d="const x=1;export{x as three,x as four};\n",
    )

    order = [text.index(f'modules["/{name}.js"] = ') for name in "dcba"]
    assert order == sorted(order)
    assert text.count('modules["/c.js"] = ') == 1
    assert 'const { one: uno } = modules["/b.js"];' in text
    assert 'const all = modules["/d.js"];' in text
    assert "return { one, other };" in text
    assert 'return { ...modules["/d.js"], two };' in text
    assert "return { three: x, four: x };" in text
    assert "export" not in text
    assert "import" not in text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('import all from "/b.js";', "cannot be joined"),
        ("export default 1;", "cannot be joined"),
        ("export let late = 1;", "cannot be joined"),
        ('const late = await import("/b.js");', "cannot be joined"),
        ("const x=1;export{x};const y=2;", "cannot be joined"),
        ('import { a } from "/a.js";', "needs itself"),
    ],
)
def test_what_cannot_be_joined_is_refused(monkeypatch, line, words):
    with pytest.raises(ValueError, match=words):
        joined(monkeypatch, a=f"{line}\n")


def test_the_script_of_the_report_cannot_end_its_element():
    text = joined_script("/report.js")

    assert "</script" not in text
    assert "<!--" not in text
    assert "WebSocket" not in text
