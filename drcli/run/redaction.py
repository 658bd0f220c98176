"""Removes secrets from texts that leave this machine, rather too much.

Known values (`known_secrets`) in every form (`secret_forms`), and `secret_patterns`.
"""

import base64
import binascii
import bz2
import gzip
import html
import json
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import quote, quote_plus

# Forms of a known secret in a text: escaped, encoded, compressed.


WHOLE_WORD_BELOW = 8
BASE64 = r"[A-Za-z0-9+/_-]"
_LARGEST_UNPACKED = 4 << 20

WRAPPED = re.compile(rf"{BASE64}{{16,}}\n(?:[ \t]*{BASE64}{{16,}}\n)*[ \t]*{BASE64}*={{0,2}}")
PACKED = re.compile(rf"(?:H4sI|eJ|eN|eA|eF|QlpoO|/Td6WFo){BASE64}{{12,}}={{0,2}}")
"""Base64 of gzip, zlib, bz2, xz."""

_UNPACK: Sequence[Callable[[bytes], bytes]] = (
    lambda data: zlib.decompressobj(47).decompress(data, _LARGEST_UNPACKED),  # zlib or gzip
    lambda data: bz2.BZ2Decompressor().decompress(data, _LARGEST_UNPACKED),
    lambda data: lzma.LZMADecompressor().decompress(data, _LARGEST_UNPACKED),
)
_BROKEN = (zlib.error, OSError, EOFError, ValueError, lzma.LZMAError, gzip.BadGzipFile)


def forms_of(value: str) -> set[str]:
    """For addresses, JSON, HTML, Python and hex."""
    forms = {value, quote(value, safe=""), quote(value), quote_plus(value)}
    forms |= {quote(form, safe="") for form in list(forms)}
    forms |= {json.dumps(value)[1:-1], json.dumps(value, ensure_ascii=False)[1:-1]}
    forms |= {form.replace("/", "\\/") for form in list(forms)}
    forms |= {html.escape(value), repr(value)[1:-1]}
    if len(value) >= WHOLE_WORD_BELOW:
        forms.add(value.encode().hex())
    return forms


def base64_cores(value: str) -> set[str]:
    """What all base64 texts with this value have."""
    if len(value) < WHOLE_WORD_BELOW:
        return set()
    cores = set()
    for before in range(3):
        coded = base64.b64encode(b"\0" * before + value.encode()).decode().rstrip("=")
        # The first and last letters also depend on what is around the value.
        first = -(-8 * before // 6)
        last = (before + len(value.encode())) * 8 // 6
        core = coded[first:last]
        cores |= {core, core.replace("+", "-").replace("/", "_")}
    return cores


def decoded(encoded: str) -> Iterator[bytes]:
    plain = encoded.replace("-", "+").replace("_", "/").rstrip("=")
    with suppress(binascii.Error, ValueError):
        data = base64.b64decode(plain[: len(plain) // 4 * 4] + _rest(plain))
        yield data
        for unpack in _UNPACK:
            with suppress(*_BROKEN):
                yield unpack(data)


def bounded(form: str) -> str:
    """A short form must be a word."""
    if len(form) >= WHOLE_WORD_BELOW:
        return re.escape(form)
    return rf"(?<![A-Za-z0-9]){re.escape(form)}(?![A-Za-z0-9])"


def contains(text: str, form: str) -> bool:
    if form.lower() not in text.lower():
        return False
    return re.search(bounded(form), text, re.IGNORECASE) is not None


def _rest(plain: str) -> str:
    rest = plain[len(plain) // 4 * 4 :]
    return rest + "=" * (-len(rest) % 4) if len(rest) > 1 else ""


# Patterns of unknown secrets: by a name before them, or their form.


_SECRET_NAME = (
    r"(?:secret|passw(?:or)?d|passphrase|\bpwd|token|credential|access[_-]?key|api[_-]?key"
    r"|private[_-]?key|account[_-]?key|shared[_-]?key|auth[_-]?key|accesskeyid|signature|cookie"
    r"|csrf|session[_-]?id|authorization|webhook)[\w.-]*"
)
_SECRET_WORDS = (
    "secret",
    "passw",
    "passphrase",
    "pwd",
    "token",
    "credential",
    "key",
    "signature",
    "cookie",
    "csrf",
    "session",
    "authorization",
    "webhook",
)
_VALUE = r"(?!\(hidden)(\"(?:[^\"\\\n]|\\.)+\"|'(?:[^'\\\n]|\\.)+'|[^\s,;&\"'}\])]+)"
_TAIL = r"[^\s\"'<>\\)]*"


@dataclass(frozen=True)
class Pattern:
    """The group `keep` stays; without any of `needs` a text cannot match."""

    kind: str
    expression: "re.Pattern[str]"
    needs: tuple[str, ...] = ()

    def may_be_in(self, low: str) -> bool:
        return not self.needs or any(word in low for word in self.needs)


def _pattern(kind: str, expression: str, needs: tuple[str, ...] = ()) -> Pattern:
    return Pattern(kind, re.compile(expression, re.IGNORECASE), needs)


PATTERNS = (
    # A header with several words; the next patterns see only one.
    _pattern(
        "HTTP header",
        r"(?P<keep>\b(?:proxy-)?authorization[\"']?\s*[:=]\s*[bu]?[\"']?)(?!\(hidden)[^\n\"']+",
        ("authorization",),
    ),
    _pattern(
        "HTTP header",
        r"(?P<keep>\b(?:set-)?cookie[\"']?\s*:\s*[bu]?[\"']?)(?!\(hidden)[^\n\"']+",
        ("cookie",),
    ),
    _pattern("bearer token", r"(?P<keep>\bbearer\s+)[\w.~+/=-]{8,}", ("bearer",)),
    _pattern("password in an address", r"(?P<keep>\b[a-z][a-z0-9+.-]*://)[^\s/\"'<>]+@", ("://",)),
    _pattern(
        "address of a webhook",
        rf"(?P<keep>https?://(?:hooks\.slack\.com|(?:\w+\.)?discord(?:app)?\.com|api\.telegram\.org"
        rf"|[\w.-]*webhook[\w.-]*|[\w.-]*\.logic\.azure\.com[:\d]*|ntfy\.sh|hooks?\.[\w.-]+)/){_TAIL}",
        ("://",),
    ),
    _pattern(
        "address of a webhook",
        rf"(?P<keep>https?://[^\s/\"'<>]+/)(?=[^\s\"'<>]*(?:hook|token|secret)){_TAIL}",
        ("://",),
    ),
    _pattern(
        "query of an address", rf"(?P<keep>\b\w+://[^\s?\"'<>]+\?)(?!\(hidden){_TAIL}", ("://",)
    ),
    _pattern(
        "signature of an address",
        r"(?P<keep>\b(?:X-Amz-[\w-]+|AWSAccessKeyId|sig)=)(?!\(hidden)[^\s&\"'<>]+",
        ("x-amz-", "awsaccesskeyid", "sig="),
    ),
    _pattern(
        "AWS key id",
        r"\b(?-i:A(?:KIA|SIA|ROA|IDA|GPA|NPA|NVA|BIA|CCA))(?-i:[A-Z0-9]{12,})",
        ("akia", "asia", "aroa", "aida", "agpa", "anpa", "anva", "abia", "acca"),
    ),
    _pattern(
        "AWS account number",
        r"(?P<keep>\barn:aws[\w-]*:[\w-]*:[\w-]*:)\d{12}",
        ("arn:aws",),
    ),
    _pattern("web token", r"\beyJ[\w-]{8,}\.[\w-]+(?:\.[\w-]*)?", ("eyj",)),
    _pattern(
        "token of a service",
        r"\b(?:gh[pousr]_\w{20,}|github_pat_\w{20,}|glpat-[\w-]{16,}|xox[abeprs]-[\w-]{10,}"
        r"|sk-[\w-]{20,}|hf_\w{20,}|AIza[\w-]{30,}|npm_\w{30,}|pypi-[\w-]{20,}|SG\.[\w-]{16,}\.[\w-]+"
        r"|ya29\.[\w-]{20,}|\d{8,10}:AA[\w-]{30,})",
        (
            "ghp_",
            "gho_",
            "ghu_",
            "ghs_",
            "ghr_",
            "github_pat_",
            "glpat-",
            "xox",
            "sk-",
            "hf_",
            "aiza",
            "npm_",
            "pypi-",
            "sg.",
            "ya29.",
            ":aa",
        ),
    ),
    _pattern(
        "value of a secret name",
        rf"(?P<keep>{_SECRET_NAME}[\"']?\s*(?:=>|[:=])\s*){_VALUE}",
        _SECRET_WORDS,
    ),
    _pattern(
        "option of a command",
        rf"(?P<keep>\s--?[\w-]*{_SECRET_NAME}\s+)(?!\(hidden)\S+",
        _SECRET_WORDS,
    ),
    _pattern(
        "option of a command",
        r"(?P<keep>\s(?:-u\s*|--user[ =]))[^\s:]+:\S+",
        (" -u", "\t-u", "\n-u", "--user"),
    ),
    _pattern("e-mail address", r"\b[\w.+-]+@[\w-]+(?:\.[\w-]+)+", ("@",)),
)
LIKE_A_KEY = re.compile(r"(?<![A-Za-z0-9/+=_-])[A-Za-z0-9/+]{40}(?![A-Za-z0-9/+=_-])")
"""AWS secret keys have no other mark."""

KEY_BLOCK = re.compile(
    r"-----BEGIN [A-Z0-9 ]*PRIVATE KEY( BLOCK)?-----.*?"
    r"(?:-----END [A-Z0-9 ]*PRIVATE KEY( BLOCK)?-----|(?=\n[^\n]*[^A-Za-z0-9+/=\s:,\\-])|\Z)",
    re.DOTALL,
)
KEY_END = re.compile(r"(?:[A-Za-z0-9+/=]{16,}\s*\n)+[^\n]*-----END [A-Z0-9 ]*PRIVATE KEY[^\n]*")


def is_like_a_key(word: str) -> bool:
    """As mixed as random letters."""
    classes = (str.isupper, str.islower, str.isdigit)
    mixed = all(any(has(letter) for letter in word) for has in classes)
    return mixed and len(set(word)) >= 16


_SHORTEST_VALUE = 4
"""Shorter secrets are removed only after a name that says what they are."""

_FOLDED_FROM = 16
"""Longer values are also found where a terminal folded them."""

_MARK = "(hidden: {})"


@dataclass(frozen=True)
class Redaction:
    file: str
    line: int
    kind: str
    count: int


class Redactor:
    """`private` are values that say who somebody is, and replacements."""

    def __init__(self, secrets: Mapping[str, str], private: Mapping[str, str]) -> None:
        self._secrets: dict[str, str] = {}
        for value, kind in secrets.items():
            # A private key has lines, of which a log may hold a single one.
            for line in {value.strip(), *value.split("\n")}:
                if len(line.strip()) >= _SHORTEST_VALUE:
                    self._secrets.setdefault(line.strip(), kind)
        self._private = {value: to for value, to in private.items() if len(value) > 2}
        self.redactions: list[Redaction] = []
        self._forms = [
            (form, self._secrets[value])
            for value in sorted(self._secrets, key=len, reverse=True)
            for form in sorted(forms_of(value), key=len, reverse=True)
        ]
        self._cores = [
            (core, kind) for value, kind in self._secrets.items() for core in base64_cores(value)
        ]

    @property
    def known(self) -> int:
        return len(self._secrets)

    def clean(self, file: str, text: str) -> str:
        counts: dict[tuple[int, str], int] = {}
        text = printable(text)
        for cut in (KEY_BLOCK, KEY_END):
            text = self._cut_blocks(cut, text, "private key", counts)
        text = self._cut_wrapped(text, counts)
        text = self._cut_encoded(text, counts)
        text = self._cut_known(text, counts)
        low = text.lower()
        for pattern in PATTERNS:
            if pattern.may_be_in(low):
                text = _replaced(text, pattern.expression, pattern.kind, counts)
        text = self._cut_likely(text, counts)
        for value, name in self._private.items():
            expression = re.compile(rf"(?<![\w.-]){re.escape(value)}(?![\w-])")
            text = _replaced(text, expression, "", counts, instead=name)
        self.redactions += [
            Redaction(file, line, kind, count) for (line, kind), count in sorted(counts.items())
        ]
        return text

    def leaks(self, text: str) -> list[str]:
        """Kinds of known secrets still in a text; another way of search."""
        joined = _joined(text)
        found = {kind for form, kind in self._forms if contains(text, form)}
        found |= {
            kind
            for form, kind in self._forms
            if len(form) >= _FOLDED_FROM and form.lower() in joined.lower()
        }
        for body in (text, joined):
            found |= {kind for core, kind in self._cores if core in body}
            for packed in PACKED.finditer(body):
                found |= set(self._kinds_in(packed[0]))
        return sorted(found)

    def _cut_known(self, text: str, counts: dict[tuple[int, str], int]) -> str:
        low = text.lower()
        joined = _joined(low)
        for form, kind in self._forms:
            if form.lower() in low:
                expression = re.compile(bounded(form), re.IGNORECASE)
                text = _replaced(text, expression, kind, counts)
            elif len(form) >= _FOLDED_FROM and form.lower() in joined:
                folded = re.compile(r"\s*".join(map(re.escape, form)), re.IGNORECASE)
                text = self._cut_blocks(folded, text, kind, counts)
        return text

    def _cut_encoded(self, text: str, counts: dict[tuple[int, str], int]) -> str:
        for core, kind in self._cores:
            if core in text:
                around = re.compile(rf"{BASE64}*{re.escape(core)}{BASE64}*={{0,2}}")
                text = _replaced(text, around, f"{kind}, encoded", counts)
        for packed in sorted({found[0] for found in PACKED.finditer(text)}, key=len, reverse=True):
            for kind in self._kinds_in(packed)[:1]:
                expression = re.compile(re.escape(packed))
                text = _replaced(text, expression, f"{kind}, compressed", counts)
        return text

    def _cut_wrapped(self, text: str, counts: dict[tuple[int, str], int]) -> str:
        def holds(block: str) -> bool:
            joined = _joined(block)
            return any(core in joined for core, _ in self._cores) or bool(self._kinds_in(joined))

        return self._cut_blocks(WRAPPED, text, "secret over several lines, encoded", counts, holds)

    def _cut_likely(self, text: str, counts: dict[tuple[int, str], int]) -> str:
        return _replaced(text, LIKE_A_KEY, "looks like a secret key", counts, only=is_like_a_key)

    def _cut_blocks(
        self,
        expression: "re.Pattern[str]",
        text: str,
        kind: str,
        counts: dict[tuple[int, str], int],
        only: Callable[[str], bool] = lambda block: True,
    ) -> str:
        def cut(found: "re.Match[str]") -> str:
            block = found[0]
            if not only(block):
                return block
            first = text.count("\n", 0, found.start()) + 1
            counts[first, kind] = counts.get((first, kind), 0) + 1
            return _MARK.format(kind) + "\n" * block.count("\n")

        return expression.sub(cut, text)

    def _kinds_in(self, encoded: str) -> list[str]:
        return [
            kind
            for data in decoded(encoded)
            for value, kind in self._secrets.items()
            if value.encode() in data
        ]


def _joined(text: str) -> str:
    return "".join(text.split())


def printable(text: str) -> str:
    """No colours and control characters.

    This comes first: a secret must not be hidden by what is removed here.
    """
    text = re.sub(r"\x1b\[[0-9;?]*[ -/]*[@-~]", "", text.replace("\r\n", "\n"))
    return re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\ufeff]", "", text)


def _replaced(
    text: str,
    expression: "re.Pattern[str]",
    kind: str,
    counts: dict[tuple[int, str], int],
    *,
    instead: str = "",
    only: Callable[[str], bool] = lambda found: True,
) -> str:
    line, seen = 1, 0

    def replace(found: "re.Match[str]") -> str:
        nonlocal line, seen
        if not only(found[0]):
            return found[0]
        line, seen = line + text.count("\n", seen, found.start()), found.start()
        if kind:
            key = line, kind
            counts[key] = counts.get(key, 0) + 1
        keep = found["keep"] if "keep" in expression.groupindex else ""
        quoted = found[0][len(keep) : len(keep) + 1]
        quotes = quoted if quoted in ("'", '"') and found[0].endswith(quoted) else ""
        return keep + quotes + (instead or _MARK.format(kind)) + quotes

    return expression.sub(replace, text)
