"""The files of the page: complete, without inline code, and nothing else can be read."""

import asyncio
import hashlib
import re
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.applications import Starlette
from starlette.testclient import TestClient

from drcli.web.console_app import page_routes

PAGES = Path(str(files("drcli.web") / "pages"))
OURS = [path for path in PAGES.rglob("*.js") if "vendor" not in path.parts]
SCRIPTS = sorted(path.relative_to(PAGES).as_posix() for path in OURS)
VENDORED = {
    "preact/preact.js": "216bb8e8b95cb0a0b2b3440dfec1beff978d52a28cf341d7be33d1884e070c11",
    "uplot/uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
}
"""SHA-256 of what scripts/vendor_preact.sh makes, and of what uPlot publishes."""
STYLES = sorted(path.relative_to(PAGES).as_posix() for path in PAGES.rglob("*.css"))


@pytest.fixture(scope="module")
def page():
    return TestClient(Starlette(routes=page_routes()), raise_server_exceptions=True)


def test_the_page_has_everything_that_it_loads(page):
    html = page.get("/").text
    loaded = re.findall(r'(?:src|href)="(/[^"]*)"', html)

    assert loaded
    for path in loaded:
        assert page.get(path).status_code == 200, path


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_module_that_a_module_loads_exists(page, script):
    text = page.get(f"/{script}").text
    loaded = re.findall(r"""(?:from|import\(?)\s*["'](/[^"']+)["']""", text)
    loaded += re.findall(r'module: "(/[^"]+)"', text)

    for path in loaded:
        assert page.get(path).status_code == 200, path


@pytest.mark.parametrize("script", SCRIPTS)
def test_scripts_obey_the_policy(page, script):
    text = page.get(f"/{script}").text

    assert not re.search(r"\beval\(|new Function\(|\.innerHTML|insertAdjacentHTML", text)
    assert not re.search(r"""["']?style["']?\s*:\s*["'`]|setAttribute\(["']style""", text)
    assert not re.search(r"""["'`](https?:)?//[a-z]""", text), "nothing is loaded from elsewhere"


def test_vendored_scripts_are_those_of_their_script(page):
    folder = PAGES / "vendor"
    scripts = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.js")}

    assert {n: hashlib.sha256(p.read_bytes()).hexdigest() for n, p in scripts.items()} == VENDORED
    assert all((path.parent / "LICENSE").is_file() for path in scripts.values())


@pytest.mark.parametrize("style", STYLES)
def test_styles_load_nothing_from_elsewhere(page, style):
    assert not re.search(r"@import|url\((?!data:|[\"']?/)", page.get(f"/{style}").text)


def test_the_html_has_no_inline_code_or_style(page):
    html = page.get("/").text

    assert not re.search(r"<script(?![^>]*\bsrc=)|\son[a-z]+=|<style|\sstyle=", html)


def test_files_have_their_types_and_are_never_old(page):
    for path, kind in [
        ("/", "text/html"),
        ("/app.js", "text/javascript"),
        ("/style.css", "text/css"),
    ]:
        answer = page.get(path)
        assert answer.headers["content-type"].startswith(kind)
        assert answer.headers["cache-control"] == "no-cache"


def test_files_are_compressed_and_not_sent_again(page):
    first = page.get("/app.js", headers={"accept-encoding": "gzip"})
    plain = page.get("/app.js", headers={"accept-encoding": "identity"})
    again = page.get("/app.js", headers={"if-none-match": first.headers["etag"]})

    assert first.headers["content-encoding"] == "gzip"
    assert int(first.headers["content-length"]) < len(plain.content) / 2
    assert first.text == plain.text
    assert (again.status_code, again.content) == (304, b"")


FUZZED = [
    "/../security.py",
    "/..%2fsecurity.py",
    "/%2e%2e/security.py",
    "/%2e%2e%2fsecurity.py",
    "/..\\security.py",
    "/%5c..%5csecurity.py",
    "/app.js/",
    "/app.js%00",
    "/%00",
    "/etc/passwd",
    "//etc/passwd",
    "/%2fetc%2fpasswd",
    "/vendor/uplot/../../../security.py",
    "/vendor/uplot/",
    "/vendor",
    "/__init__.py",
    "/pages/app.js",
    "/system.env",
    "/data/viewer/token.json",
    "/data/viewer/viewer.json",
    "/App.js",
    "/app.js.bak",
    "/app.js;x",
    "/app.js%20",
    "/\u202eapp.js",
    "/ａpp.js",
    "/" + "a" * 20_000,
    "/" + "../" * 500 + "etc/passwd",
]


@pytest.mark.parametrize("path", FUZZED)
def test_no_other_file_can_be_read(page, path):
    answer = page.get(path)

    assert answer.status_code == 404
    assert answer.text == "There is no such page."


@given(st.text(alphabet=st.sampled_from("./\\%2e0fabc\x00é:~"), max_size=40))
def test_no_path_leads_out_of_the_page(path):
    scope = {"type": "http", "method": "GET", "path": f"/{path}", "headers": []}
    app = Starlette(routes=page_routes())

    status, text = asyncio.run(answer_of(app, scope))

    assert status == 404 or text == (PAGES / "index.html").read_bytes()


async def answer_of(app, scope):
    """Status and content, whatever the path: clients would change it."""
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request"}

    await app(scope, receive, send)
    return sent[0]["status"], sent[1]["body"]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_files_are_only_read(page, method):
    assert page.request(method, "/app.js").status_code == 405
