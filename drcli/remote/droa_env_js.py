"""Reads env.js, in which a DeepRacer on AWS names its parts.

It is JavaScript: other quotes or none, comments, extra commas, variables. Nothing is executed.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

NAME = "EnvironmentConfig"
"""Source: deepracer-on-aws."""

_TOKEN = re.compile(
    r"""
    (?P<space> \s+ | //[^\n]* | /\*.*?\*/ )
  | (?P<text> "(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)*' | `(?:[^`\\]|\\.)*` )
  | (?P<word> [\w$.-]+ )
  | (?P<sign> . )
    """,
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(r"\\(?:u\{([0-9a-fA-F]{1,6})\}|u([0-9a-fA-F]{4})|x([0-9a-fA-F]{2})|(.))", re.S)
_LETTERS = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f", "v": "\v", "0": "\0", "\n": ""}
_CLOSING = {"{": "}", "[": "]", "(": ")"}


class NotEnvJs(ValueError):
    """Says what there is instead."""


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str


def read_env_js(script: str) -> dict[str, str]:
    """The texts of `window.EnvironmentConfig`, or NotEnvJs."""
    if script.lstrip("\ufeff \t\r\n").startswith("<"):
        raise NotEnvJs("it is a web page")
    tokens = tuple(_tokens(script))
    for at, token in enumerate(tokens):
        if token.text == "=" and _names(tokens, at) == NAME:
            return _object(tokens, at + 1)
    raise NotEnvJs(f"it does not set {NAME}")


def _tokens(script: str) -> Iterator[_Token]:
    for match in _TOKEN.finditer(script):
        kind = str(match.lastgroup)
        if kind != "space":
            yield _Token(kind, match[0])


def _names(tokens: tuple[_Token, ...], at: int) -> str:
    if at and tokens[at - 1].kind == "word":
        return tokens[at - 1].text.rpartition(".")[2]
    if at > 1 and tokens[at - 1].text == "]" and tokens[at - 2].kind == "text":
        return _plain(tokens[at - 2].text)
    return ""


def _object(tokens: tuple[_Token, ...], at: int) -> dict[str, str]:
    for place in range(at, len(tokens)):
        token = tokens[place]
        following = tokens[place + 1].text if place + 1 < len(tokens) else ";"
        if token.text == "{":
            return _pairs(tokens, place + 1)
        if token.kind == "text":  # JSON.parse('...')
            return _from_json(_plain(token.text))
        if token.kind == "word" and following != "(":
            return _variable(tokens[:at], token.text)
        if token.kind == "sign" and token.text != "(":
            break
    raise NotEnvJs(f"{NAME} is not an object")


def _variable(tokens: tuple[_Token, ...], name: str) -> dict[str, str]:
    for at in range(len(tokens) - 1, 0, -1):
        if tokens[at].text == "=" and tokens[at - 1].text == name:
            return _object(tokens, at + 1)
    raise NotEnvJs(f"{NAME} is {name}, which it does not define")


def _from_json(text: str) -> dict[str, str]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise NotEnvJs(f"{NAME} is not an object")
    return {str(key): value for key, value in values.items() if isinstance(value, str)}


def _pairs(tokens: tuple[_Token, ...], at: int) -> dict[str, str]:
    found: dict[str, str] = {}
    item: list[_Token] = []
    ends = ["}"]
    for token in tokens[at:]:
        text = token.text if token.kind == "sign" else ""
        if text == ends[-1]:
            ends.pop()
        elif text in _CLOSING:
            ends.append(_CLOSING[text])
        if not ends or (text == "," and len(ends) == 1):
            found.update(_pair(item))
            item = []
        else:
            item.append(token)
        if not ends:
            return found
    raise NotEnvJs(f"the object of {NAME} is not complete")


def _pair(item: list[_Token]) -> dict[str, str]:
    """`"a" + "b"` is one text."""
    if len(item) < 3 or item[1].text != ":" or item[0].kind == "sign":
        return {}
    parts = item[2:]
    texts, plus = parts[::2], parts[1::2]
    if any(t.kind != "text" or "${" in t.text for t in texts) or any(t.text != "+" for t in plus):
        return {}
    key = _plain(item[0].text) if item[0].kind == "text" else item[0].text
    return {key: "".join(_plain(token.text) for token in texts)}


def _plain(quoted: str) -> str:
    def letter(match: "re.Match[str]") -> str:
        number = match[1] or match[2] or match[3]
        if number:
            code = int(number, 16)
            return chr(code) if code <= 0x10FFFF else ""
        return _LETTERS.get(match[4], match[4])

    text = _ESCAPE.sub(letter, quoted[1:-1])
    # JavaScript writes a letter beyond 16 bits as two escapes.
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
