"""Removes secrets from texts that leave this machine, rather too much.

Known values (`known_secrets`) in every form (`secret_forms`), and `secret_patterns`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drcli.runs.secret_forms import (
    BASE64,
    PACKED,
    WRAPPED,
    base64_cores,
    bounded,
    contains,
    decoded,
    forms_of,
)
from drcli.runs.secret_patterns import (
    KEY_BLOCK,
    KEY_END,
    LIKE_A_KEY,
    PATTERNS,
    is_like_a_key,
)

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
