"""No form of a secret survives, known or not, and what is no secret does."""

import base64
import bz2
import gzip
import html
import json
import lzma
import textwrap
import zlib
from urllib.parse import quote, quote_plus

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.run.redaction import Redaction, Redactor

SECRET = "wJalr/XUtnFEMI+K7MDENG=bPxRfiCY&é"
KNOWN = {SECRET: "key of somebody"}


def b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


FORMS = {
    "plain": lambda v: v,
    "in an address": lambda v: quote(v, safe=""),
    "in a form": quote_plus,
    "lower case escapes": lambda v: quote(v, safe="").lower(),
    "twice in an address": lambda v: quote(quote(v, safe=""), safe=""),
    "JSON": json.dumps,
    "JSON with slashes": lambda v: json.dumps(v).replace("/", "\\/"),
    "HTML": html.escape,
    "Python": repr,
    "hex": lambda v: v.encode().hex(),
    "capital hex": lambda v: v.encode().hex().upper(),
    "base64": lambda v: b64(v.encode()),
    "base64 later": lambda v: b64(b"user:" + v.encode() + b" and more"),
    "base64 for addresses": lambda v: base64.urlsafe_b64encode(b"xy" + v.encode()).decode(),
    "wrapped base64": lambda v: "\n".join(textwrap.wrap(b64(b"x" * 90 + v.encode() * 2), 64)),
    "gzip": lambda v: b64(gzip.compress(b"key=" + v.encode())),
    "zlib": lambda v: b64(zlib.compress(v.encode())),
    "bz2": lambda v: b64(bz2.compress(v.encode())),
    "xz": lambda v: b64(lzma.compress(v.encode())),
    "coloured": lambda v: f"{v[:5]}\x1b[31m{v[5:]}\x1b[0m",
    "with zeros between": lambda v: "\0".join(v),
    "folded": lambda v: f"{v[:20]}\n  {v[20:]}",
    "other case": lambda v: v.swapcase(),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_known_secret_is_found_in_every_form_and_is_listed(form):
    redactor = Redactor(KNOWN, {})
    hidden = FORMS[form](SECRET)

    cleaned = redactor.clean("a.log", f"first line\nsaid <{hidden}> twice\nlast line\n")

    for part in hidden.split("\n"):
        assert part.strip() not in cleaned
    assert redactor.leaks(cleaned) == []
    assert cleaned.startswith("first line\n")
    assert cleaned.endswith("last line\n")
    assert {found.line for found in redactor.redactions} == {2}
    assert SECRET not in repr(redactor.redactions)


@pytest.mark.parametrize("form", [form for form in FORMS if form != "coloured"])
def test_a_search_afterwards_would_notice_a_form_that_was_missed(form):
    text = f"said {FORMS[form](SECRET)} once".replace("\0", "")

    assert Redactor(KNOWN, {}).leaks(text) == ["key of somebody"]


@given(
    secret=st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=8, max_size=48),
    before=st.text(max_size=20),
    after=st.text(max_size=20),
    form=st.sampled_from(sorted(set(FORMS) - {"other case", "folded", "wrapped base64"})),
)
def test_no_secret_survives_wherever_it_stands(secret, before, after, form):
    redactor = Redactor({secret: "a secret"}, {})
    hidden = FORMS[form](secret)

    cleaned = redactor.clean("a.log", f"{before} {hidden} {after}")

    assert redactor.leaks(cleaned) == []
    assert secret not in cleaned


KEY = "-----BEGIN OPENSSH PRIVATE KEY-----\n{}\n-----END OPENSSH PRIVATE KEY-----"
LINES = "\n".join(["b3BlbnNzaC1rZXktdjEAAAAABG5vbmUAAAAEbm9uZQAAAAAAAAAB"] * 3)


@pytest.mark.parametrize(
    ("text", "secret"),
    [
        ("id AKIAIOSFODNN7EXAMPLE used", "AKIAIOSFODNN7EXAMPLE"),
        ("aws_secret_access_key = abc/def+ghi", "abc/def+ghi"),
        ('{"password": "pa ss, word"}', "pa ss, word"),
        ("DB_PASSWORD='it is \\' long'", "long"),
        ("Authorization: Bearer abcdefgh.ijklmnop", "abcdefgh.ijklmnop"),
        ("authorization: AWS4-HMAC-SHA256 Credential=x/y, Signature=feed1234", "feed1234"),
        ("'Authorization': b'Basic dXNlcjpwYXNz'", "dXNlcjpwYXNz"),
        ("Set-Cookie: session=a1b2c3; Path=/; other=d4e5", "d4e5"),
        ("used bearer 0123456789abcdef", "0123456789abcdef"),
        ("postgres://user:p@ss@host:5432/db", "p@ss"),
        ("https://b.s3.amazonaws.com/k?X-Amz-Signature=0123&X-Amz-Credential=4567", "0123"),
        ("X-Amz-Security-Token=FwoGZXIvYXdz", "FwoGZXIvYXdz"),
        ("https://hooks.slack.com/services/T00/B00/XXXX", "T00/B00/XXXX"),
        ("https://discord.com/api/webhooks/123/abc-def", "abc-def"),
        ("POST https://my.site/v1/webhook/9f8e7d", "9f8e7d"),
        ("https://api.telegram.org/bot12345:AAF/sendMessage", "12345:AAF"),
        ("eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiIxIn0.s1gnature", "s1gnature"),
        ("ghp_0123456789abcdefghijABCDEFGHIJ012345", "ghp_0123456789"),
        ("key kXz8Qm2Vt5Lp9Wn3Rb7Hd1Fg4Jc6Ys0Ua+Eo/Tix ok", "kXz8Qm2Vt5Lp9Wn3"),
        ("mysql --password hunter2 -h x", "hunter2"),
        ("curl -u me:hunter2 https://x", "hunter2"),
        ("write to jane.doe+x@example.co.uk today", "jane.doe"),
        ("arn:aws:sns:eu-west-1:123456789012:topic", "123456789012"),
        (KEY.format(LINES), "b3BlbnNzaC1"),
        (KEY.format(LINES).partition("-----END")[0], "b3BlbnNzaC1"),
        (KEY.format(LINES).partition("KEY-----\n")[2], "b3BlbnNzaC1"),
        (json.dumps(KEY.format(LINES)), "b3BlbnNzaC1"),
    ],
)
def test_secrets_that_nobody_knows_are_found_by_their_form(text, secret):
    cleaned = Redactor({}, {}).clean("x", f"before\n{text}\nafter.\n")

    assert secret not in cleaned
    assert cleaned.startswith("before\n")
    assert cleaned.endswith("after.\n")
    assert cleaned.count("\n") == text.count("\n") + 3


HARMLESS = """2026-11-22 19:00:00 INFO Training> Name=main_level/agent, Worker=0, Episode=20
SIM_TRACE_LOG:0,1,-0.61,2.93,-83.2,-30.00,0.60,7,0.0000,False,True,0.8,3,17.67,1763813412.7,start
/home/someone/racing/data/logs/robomaker/sim-0.log model/model/1_Step-500.ckpt.safetensors
sha256 e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855
commit 9e15d329e15d329e15d329e15d329e15d329e15d
http://127.0.0.1:22566 answers; s3://bucket/model DR_LOCAL_S3_REWARD_KEY=custom_files/reward.py
exit code=3, torch==2.13.0+cpu, exploration_type: categorical, steps: 512
"""


def test_logs_without_secrets_stay_as_they_are():
    redactor = Redactor(KNOWN, {})

    assert redactor.clean("x", HARMLESS) == HARMLESS
    assert redactor.redactions == []


def test_short_secrets_are_removed_as_whole_words_only():
    redactor = Redactor({"tree": "a password"}, {})

    assert redactor.clean("x", "tree streets tree2 (tree)") == (
        "(hidden: a password) streets tree2 ((hidden: a password))"
    )


def test_who_somebody_is_is_replaced_without_being_called_a_secret():
    redactor = Redactor({}, {"/home/jane": "~", "jane": "(user name)"})

    cleaned = redactor.clean("x", "/home/jane/racing by jane on janet")

    assert cleaned == "~/racing by (user name) on janet"
    assert redactor.redactions == []


def test_each_removal_names_file_line_and_kind():
    redactor = Redactor({"hunter2hunter2": "password of x"}, {})

    redactor.clean("a.log", "1\n2 hunter2hunter2 hunter2hunter2\n3\n4 AKIAIOSFODNN7EXAMPLE")

    assert redactor.redactions == [
        Redaction("a.log", 2, "password of x", 2),
        Redaction("a.log", 4, "AWS key id", 1),
    ]
