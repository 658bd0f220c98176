"""How an answer with pictures is packed: JSON facts, and then the pictures one after the other."""

import json
from collections.abc import Sequence
from typing import Any

from drcli.base.plain_json import plain

LENGTH_BYTES = 4


def pack(facts: dict[str, Any], pictures: Sequence[bytes] = ()) -> bytes:
    """Four bytes with the length of the facts (big endian), the facts as JSON, and the pictures.

    The facts get a list `lengths` with the size of each picture in bytes.
    """
    told = {**plain(facts), "lengths": [len(picture) for picture in pictures]}
    head = json.dumps(told, separators=(",", ":")).encode()
    return b"".join([len(head).to_bytes(LENGTH_BYTES, "big"), head, *pictures])


def unpack(data: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Facts and pictures of a packed answer.

    Raises:
        ValueError: It is not one.
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
    """The facts alone, of an answer that is known to be whole."""
    head_end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES], "big")
    facts: dict[str, Any] = json.loads(data[LENGTH_BYTES:head_end])
    del facts["lengths"]
    return facts
