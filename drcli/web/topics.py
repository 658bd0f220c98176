"""Values that the page follows; each gives every client what is new to it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from drcli.base.json_record import plain
from drcli.web.page_words import for_page

Marker = Any
"""What a client has got; only the topic's value reads it."""

Message = str | bytes
"""JSON, or a picture with its header, see `Picture`."""


class Value(Protocol):
    """Of a topic."""

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        """What is new since a marker, or None; and the new marker."""


def text_message(topic: str, data: Any) -> str:
    return json.dumps({"topic": topic, "data": data}, allow_nan=False, separators=(",", ":"))


@dataclass(frozen=True)
class Snapshot:
    """Sent as a whole when it has changed."""

    topic: str
    text: str

    @staticmethod
    def of(topic: str, value: Any) -> "Snapshot":
        return Snapshot(topic, text_message(topic, for_page(plain(value))))

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        return (None if since == self.text else self.text), self.text


class Rows:
    """A list that grows, such as iterations: clients get what has changed.

    When an earlier row changes or the list becomes shorter, they get it from there on.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._rows: list[Any] = []
        self._texts: list[str] = []
        self._changed: list[int] = []
        self._version = 0

    def update(self, rows: Sequence[Any]) -> None:
        # Texts are compared, because a row with NaN is not equal to itself when it is read again.
        texts = [
            self._texts[k] if k < len(self._rows) and row is self._rows[k] else _row_text(row)
            for k, row in enumerate(rows)
        ]
        if texts != self._texts:
            known = zip(self._changed, self._texts, texts, strict=False)
            now = self._version = self._version + 1
            changed = [version if old == new else now for version, old, new in known]
            self._changed = changed + [now] * (len(texts) - len(changed))
        self._rows, self._texts = list(rows), texts

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        """`{"start": k, "rows": [...]}`: replace everything from row k on."""
        if since == self._version:
            return None, since
        changed = enumerate(self._changed)
        later = (k for k, version in changed if since is None or version > since)
        start = next(later, len(self._texts))
        rows = ",".join(self._texts[start:])
        topic = json.dumps(self._topic)
        return f'{{"topic":{topic},"data":{{"start":{start},"rows":[{rows}]}}}}', self._version


def _row_text(row: Any) -> str:
    return json.dumps(plain(row), allow_nan=False, separators=(",", ":"))


@dataclass(frozen=True, eq=False)
class Picture:
    """A JPEG picture: two bytes with the length of a JSON header, the header, the picture."""

    topic: str
    jpeg: bytes
    facts: dict[str, Any]

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        if since is self:
            return None, self
        header = json.dumps({"topic": self.topic, **self.facts}, allow_nan=False).encode()
        return len(header).to_bytes(2, "big") + header + self.jpeg, self
