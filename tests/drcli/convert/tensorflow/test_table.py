"""Tables: what is written is read, and what is damaged is refused."""

import random
import struct

import pytest

from drcli.base.errors import SettingsError
from drcli.convert.tensorflow.bundle import masked_crc, read_table, write_table

MANY = {
    f"name/{number:05d}".encode(): bytes([number % 251]) * (number % 40) for number in range(900)
}


@pytest.mark.parametrize(
    "entries", [{}, {b"": b"header"}, {b"a": b""}, {b"\xff\xff": b"x", b"\xff": b"y"}, MANY]
)
@pytest.mark.parametrize("block_bytes", [1, 300, 1 << 18])
def test_what_is_written_is_read(entries, block_bytes):
    table = write_table(entries, block_bytes=block_bytes)

    assert read_table(table, "x.index") == entries


def test_keys_of_one_block_share_their_beginnings():
    names = {f"main_level/agent/main/online/{number:04d}".encode(): b"" for number in range(64)}

    table = write_table(names)

    assert len(table) < 0.4 * sum(map(len, names))


def test_the_checksum_is_crc_32c_rotated_plus_a_constant():
    # CRC-32C of these bytes is 0xE3069283 (RFC 3720 has the polynomial). Rotated by 15: 0x2507C60D.
    assert masked_crc(b"123456789") == (0x2507C60D + 0xA282EAD8) & 0xFFFFFFFF


def test_every_altered_byte_is_noticed():
    table = write_table(MANY, block_bytes=2000)

    for position in range(0, len(table), 37):
        altered = bytearray(table)
        altered[position] ^= 0x40

        found = outcome(bytes(altered))

        if isinstance(found, str):
            assert found.startswith("x.index")
        else:  # the footer's padding means nothing
            assert found == MANY
            assert position > len(table) - 48


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(share):
    table = write_table(MANY)

    with pytest.raises(SettingsError, match=r"x\.index is not the index .* or its end is missing"):
        read_table(table[: int(len(table) * share)], "x.index")


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04" + bytes(500), b"\x80\x04]q\x00." * 20])
def test_another_file_is_refused(data):
    with pytest.raises(SettingsError, match="is not the index of a TensorFlow checkpoint"):
        read_table(data, "x.index")


def test_a_compressed_table_is_named_as_such():
    content = b"\x00" * 8
    with pytest.raises(SettingsError, match="compressed with Snappy"):
        read_table(table_of(content, kind=1), "x.index")
    with pytest.raises(SettingsError, match="unknown compression 7"):
        read_table(table_of(content, kind=7), "x.index")


@pytest.mark.parametrize(
    ("entries", "fault"),
    [
        (b"\x00\x01\x01aX\x00\x01\x01aY", "the key 'a' is not after 'a'"),
        (b"\x00\x01\x01bX\x00\x01\x01aY", "the key 'a' is not after 'b'"),
        (b"\x05\x01\x01aX", "an entry is longer than its block"),
        (b"\x00\x01\x7faX", "an entry is longer than its block"),
        (b"\x00\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff", "more than 64 bits"),
        (b"\x00\x80", "ends inside a number"),
    ],
)
def test_a_block_with_wrong_entries_is_refused(entries, fault):
    with pytest.raises(SettingsError, match=fault):
        read_table(table_of(entries + struct.pack("<II", 0, 1)), "x.index")


def test_a_block_that_claims_more_restart_points_than_fit_is_refused():
    with pytest.raises(SettingsError, match="claims 99 restart points"):
        read_table(table_of(struct.pack("<II", 0, 99)), "x.index")


def test_a_small_file_cannot_claim_gigabytes_of_names():
    start = b"\x00\x88\x27\x00" + b"a" * 5000
    more = b"".join(b"\x88\x27\x01\x00" + bytes([byte]) for byte in range(200))

    with pytest.raises(SettingsError, match="more than 4096 bytes"):
        read_table(table_of(start + more + struct.pack("<II", 0, 1)), "x.index")


def test_random_bytes_with_a_valid_footer_never_end_in_a_traceback():
    chance = random.Random(7)
    for _ in range(300):
        content = chance.randbytes(chance.randrange(40)) + struct.pack("<I", chance.randrange(3))

        found = outcome(table_of(content))

        assert isinstance(found, dict) or found.startswith("x.index is damaged")


def outcome(data):
    """What reading a table gives: its entries, or the message."""
    try:
        return read_table(data, "x.index")
    except SettingsError as error:
        return str(error)


def table_of(content, kind=0):
    """A table whose only block has this content and right checksums, with an index by hand."""
    block = content + bytes([kind])
    block += struct.pack("<I", masked_crc(block))
    handle = varint(0) + varint(len(content))
    index = b"\x00\x01" + bytes([len(handle)]) + b"z" + handle + struct.pack("<II", 0, 1)
    index_block = index + b"\x00"
    index_block += struct.pack("<I", masked_crc(index_block))
    handles = varint(0) + varint(0) + varint(len(block)) + varint(len(index))
    footer = handles + bytes(40 - len(handles)) + struct.pack("<Q", 0xDB4775248B80FB57)
    return block + index_block + footer


def varint(number):
    """A number as tables have it."""
    encoded = b""
    while number >= 0x80:
        encoded += bytes([number & 0x7F | 0x80])
        number >>= 7
    return encoded + bytes([number])
