"""The form of answers: JSON facts, then pictures."""

import json
from collections.abc import Sequence
from typing import Any

from drcli.base.plain_json import plain

LENGTH_BYTES = 4


def pack(facts: dict[str, Any], pictures: Sequence[bytes] = ()) -> bytes:
    """Four bytes of length (big endian), JSON facts, pictures.

    The facts get `lengths`, the pictures' bytes.
    """
    told = {**plain(facts), "lengths": [len(picture) for picture in pictures]}
    head = json.dumps(told, separators=(",", ":")).encode()
    return b"".join([len(head).to_bytes(LENGTH_BYTES, "big"), head, *pictures])


def unpack(data: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Facts and pictures.

    Raises:
        ValueError: It is not a packed answer.
    """
    head_end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES], "big")
    if len(data) < head_end:
        raise ValueError("The answer is cut off.")
    facts = json.loads(data[LENGTH_BYTES:head_end])
    pictures, at = [], head_end
    for length in facts.pop("lengths"):
        pictures.append(data[at : at + length])
        at += length
    if at != len(data):
        raise ValueError("The pictures of the answer do not have the lengths that it tells.")
    return facts, pictures


def facts_of(data: bytes) -> dict[str, Any]:
    """Of an answer known to be whole."""
    head_end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES], "big")
    facts: dict[str, Any] = json.loads(data[LENGTH_BYTES:head_end])
    del facts["lengths"]
    return facts
