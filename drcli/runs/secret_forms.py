"""Forms of a known secret in a text: escaped, encoded, compressed."""

import base64
import binascii
import bz2
import gzip
import html
import json
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from urllib.parse import quote, quote_plus

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
