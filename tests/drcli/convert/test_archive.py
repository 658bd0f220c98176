"""Archives that anybody may have made: what is read, and what is refused with one sentence."""

import bz2
import gzip
import io
import lzma
import os
import pickle
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drcli.base import archive
from drcli.base import archive as gzip_stream
from drcli.base.archive import read_archive, unpack_archive, unpack_readable
from drcli.base.errors import SettingsError

FORMATS = {"ustar": tarfile.USTAR_FORMAT, "gnu": tarfile.GNU_FORMAT, "pax": tarfile.PAX_FORMAT}
FILES = {"model_metadata.json": b"{}", "agent/model.pb": b"\x0a graph" * 200}


def packed(
    files: dict[str, bytes] = FILES,
    *,
    kind: int = tarfile.PAX_FORMAT,
    compress: bool = True,
    extra: Callable[[tarfile.TarFile], None] = lambda tar: None,
) -> bytes:
    """An archive of these files, as Python's own writer makes it."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz" if compress else "w", format=kind) as tar:
        for name, data in files.items():
            add(tar, name, data)
        extra(tar)
    return stream.getvalue()


def zipped(
    files: dict[str | zipfile.ZipInfo, bytes], compression: int = zipfile.ZIP_DEFLATED
) -> bytes:
    """A ZIP archive of these files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as made:
        for name, data in files.items():
            made.writestr(name, data, compression)
    return stream.getvalue()


def add(tar: tarfile.TarFile, name: str, data: bytes = b"", **fields: object) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    for field, value in fields.items():
        setattr(member, field, value)
    tar.addfile(member, io.BytesIO(data))


def unpack(data: bytes) -> dict[str, bytes]:
    return unpack_archive(io.BytesIO(data), "a.tar.gz")


def refusal(data: bytes) -> str:
    with pytest.raises(SettingsError) as refused:
        unpack(data)
    text = str(refused.value)
    assert text.startswith("a.tar.gz")
    assert "\n" not in text
    assert refused.value.remedy
    return text


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("kind", FORMATS.values(), ids=FORMATS)
def test_files_of_every_format_are_read(kind, compress):
    files = {**FILES, "empty": b"", "block": b"x" * 512, "deep/er/still/file.txt": b"text"}

    assert unpack(packed(files, kind=kind, compress=compress)) == files


@pytest.mark.parametrize("kind", ["gnu", "pax"])
def test_long_names_and_names_in_other_scripts_are_read(kind):
    files = {"folder/" * 40 + "model.pb": b"graph", "modèle-赛车.json": b"{}"}

    assert unpack(packed(files, kind=FORMATS[kind])) == files


def test_a_long_name_of_the_oldest_format_is_read():
    name = "folder/" * 20 + "model.pb"

    assert unpack(packed({name: b"graph"}, kind=tarfile.USTAR_FORMAT)) == {name: b"graph"}


def test_a_size_in_the_binary_form_is_read():
    data = bytearray(packed({"a": b"12345"}, kind=tarfile.GNU_FORMAT, compress=False))
    data[124:136] = b"\x80" + bytes(10) + b"\x05"
    data[148:156] = b" " * 8
    data[148:156] = b"%06o\0 " % sum(data[:512])

    assert unpack(bytes(data)) == {"a": b"12345"}


def test_what_tar_makes_of_a_folder_is_read_without_its_dots():
    def folders(tar: tarfile.TarFile) -> None:
        add(tar, ".", type=tarfile.DIRTYPE)
        add(tar, "./agent", type=tarfile.DIRTYPE)
        add(tar, "./agent//model.pb", b"graph")

    assert unpack(packed({}, extra=folders)) == {"agent/model.pb": b"graph"}


def test_compressed_parts_one_after_another_are_one_archive():
    data = packed(compress=False)
    parts = gzip.compress(data[:700]) + gzip.compress(b"") + gzip.compress(data[700:])

    assert unpack(parts) == FILES
    assert unpack(parts + bytes(1024)) == FILES


def test_an_archive_without_files_is_empty():
    assert unpack(packed({})) == {}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("../evil", "leads out of the archive"),
        ("agent/../../evil", "leads out of the archive"),
        ("/etc/passwd", "has an absolute name"),
        ("C:/windows", "has an absolute name"),
        ("agent\\model.pb", "has a name that is not allowed"),
        ("agent/\x1b[31mred", "has a name that is not allowed"),
        ("x" * 2000, "has a name that is too long"),
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(name, reason):
    def evil(tar: tarfile.TarFile) -> None:
        add(tar, name, b"text")

    assert refusal(packed(extra=evil)).endswith(f" {reason}.")


def test_a_folder_that_leads_elsewhere_is_refused_too():
    def evil(tar: tarfile.TarFile) -> None:
        add(tar, "../up", type=tarfile.DIRTYPE)

    assert "../up/ leads out of the archive" in refusal(packed(extra=evil))


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (tarfile.SYMTYPE, "is a symbolic link"),
        (tarfile.LNKTYPE, "is a hard link"),
        (tarfile.CHRTYPE, "is a device"),
        (tarfile.BLKTYPE, "is a device"),
        (tarfile.FIFOTYPE, "is a named pipe"),
        (tarfile.GNUTYPE_SPARSE, "is a sparse file"),
        (b"Q", "is of an unknown kind"),
    ],
)
def test_what_is_no_file_is_refused(kind, reason):
    def special(tar: tarfile.TarFile) -> None:
        add(tar, "odd", type=kind, linkname="/etc/passwd")

    assert f"a.tar.gz: odd {reason}" in refusal(packed(extra=special))


def test_a_link_with_a_long_target_is_refused_as_a_link():
    def link(tar: tarfile.TarFile) -> None:
        add(tar, "odd", type=tarfile.SYMTYPE, linkname="../" * 80)

    assert "odd is a symbolic link" in refusal(packed(kind=tarfile.GNU_FORMAT, extra=link))


@pytest.mark.parametrize("again", ["model_metadata.json", "./model_metadata.json"])
def test_a_name_that_occurs_twice_is_refused(again):
    def twice(tar: tarfile.TarFile) -> None:
        add(tar, again, b"other")

    assert "model_metadata.json occurs twice" in refusal(packed(extra=twice))


@pytest.mark.parametrize("order", [["agent", "agent/model.pb"], ["agent/model.pb", "agent"]])
def test_a_file_that_is_also_a_folder_is_refused(order):
    assert ": agent " in refusal(packed(dict.fromkeys(order, b"text")))


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("name", ["agent/model.pb", "5_Step-7.ckpt.data-00000-of-00001", "x.pt"])
def test_a_pickle_where_weights_are_expected_is_refused(name, protocol):
    data = pickle.dumps({"weights": [1.0, 2.0], "name": os.path.join}, protocol=protocol)

    assert f"{name} is a Python pickle" in refusal(packed({name: data}))


def test_a_file_of_pytorch_is_refused_as_the_pickle_that_it_contains():
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as inner:
        inner.writestr("archive/data.pkl", pickle.dumps([1]))

    assert "model.pt is a Python pickle" in refusal(packed({"model.pt": stream.getvalue()}))


@pytest.mark.parametrize("data", [b"", b".", b"\x80\x04", bytes(range(256)) * 40, b"\0" * 5000])
def test_other_data_is_no_pickle(data):
    name = "5_Step-7.ckpt.data-00000-of-00001"

    assert unpack(packed({name: data})) == {name: data}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "is empty"),
        (b"hello", "is not a tar archive"),
        (b"x" * 3000, "is not a tar archive"),
        (gzip.compress(b"hello", mtime=0), "is not a tar archive"),
        (b"\x1f\x8b\x08", "is truncated"),
        (b"\x1f\x8b" + b"x" * 600, "is damaged"),
        (b"PK\x03\x04" + bytes(600), "is a ZIP file"),
        (b"BZh91AY", "is a bzip2 file"),
        (b"\xfd7zXZ\x00\x00", "is a xz file"),
    ],
)
def test_a_file_of_another_kind_is_refused(data, reason):
    assert reason in refusal(data)


@pytest.mark.parametrize("compress", [True, False])
def test_an_archive_that_ends_early_is_refused_wherever_it_ends(compress):
    data = packed(kind=tarfile.USTAR_FORMAT, compress=compress).rstrip(b"\0")
    lengths = range(1, len(data), 1 if compress else 97)

    for length in lengths:
        refusal(data[:length])


def test_a_changed_byte_anywhere_in_a_compressed_archive_is_noticed():
    data = packed()

    for position in range(10, len(data), 3):  # what comes before tells only time and system
        changed = bytearray(data)
        changed[position] ^= 0x55
        refusal(bytes(changed))


def test_a_damaged_header_in_the_middle_is_not_taken_for_the_end():
    data = bytearray(packed(kind=tarfile.USTAR_FORMAT, compress=False))
    data[1024 + 3] ^= 1  # in the name of the second file

    assert "is damaged: a header is wrong" in refusal(bytes(data))


def test_data_after_the_end_of_a_compressed_archive_is_refused():
    assert "other data follows its end" in refusal(packed() + b"more")


def test_a_bomb_is_refused_before_it_is_unpacked():
    pack = zlib.compressobj(9, wbits=31)
    header = tarfile.TarInfo("zeros.bin")
    header.size = 400 << 20
    bomb = pack.compress(header.tobuf())
    for _ in range(400):
        bomb += pack.compress(bytes(1 << 20))
    bomb += pack.flush()

    assert len(bomb) < 1 << 20
    assert "unpacks to more than 100 times its size" in refusal(bomb)


def test_a_bomb_after_the_end_of_the_archive_is_refused_too():
    bomb = packed() + gzip.compress(bytes(64 << 20))

    assert "unpacks to more than 100 times its size" in refusal(bomb)


def test_the_size_of_the_whole_is_limited(monkeypatch):
    monkeypatch.setattr(gzip_stream, "LARGEST_BYTES", 1 << 20)
    files = {f"{number}.txt": os.urandom(300_000) for number in range(4)}

    assert "unpacks to more than 1 MB" in refusal(packed(files))
    assert "unpacks to more than 1 MB" in refusal(packed(files, compress=False))


def test_a_member_that_says_it_is_huge_is_refused_without_reading_it():
    header = tarfile.TarInfo("huge.bin")
    header.size = 600 << 20

    assert "huge.bin has 629,145,600 bytes" in refusal(header.tobuf() + bytes(512))


def test_too_many_members_are_refused(monkeypatch):
    monkeypatch.setattr(archive, "MOST_MEMBERS", 3)

    assert "has more than 3 members" in refusal(packed({str(n): b"" for n in range(4)}))


def test_a_header_that_says_it_is_huge_is_refused():
    header = tarfile.TarInfo("././@PaxHeader")
    header.type = tarfile.XHDTYPE
    header.size = 1 << 30

    assert "has a header of 1,073,741,824 bytes" in refusal(header.tobuf() + bytes(512))


@pytest.mark.parametrize(
    "text",
    [
        b"9999 path=x\n",
        b"x path=x\n",
        b"11 pathless\n",
        b"3 \n",
        b"0 path=x\n",
        b"20 GNU.sparse.map=1\n",
        b"11 size=-5\n\n",
        b"11 size=5x\n",
    ],
)
def test_a_crafted_attribute_is_refused(text):
    header = tarfile.TarInfo("attributes")
    header.type, header.size = tarfile.XHDTYPE, len(text)
    file = tarfile.TarInfo("file")
    data = header.tobuf() + text + bytes(-len(text) % 512) + file.tobuf() + bytes(1024)

    refusal(data)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    position=st.integers(0, 2047),
    replacement=st.binary(min_size=1, max_size=12),
    compress=st.booleans(),
)
def test_no_change_of_an_archive_causes_another_error(position, replacement, compress):
    data = bytearray(packed(kind=tarfile.GNU_FORMAT, compress=False))
    data[position : position + len(replacement)] = replacement

    with suppress(SettingsError):
        unpack(gzip.compress(bytes(data)) if compress else bytes(data))


def test_a_zip_file_and_every_compression_of_a_tar_give_the_same_files():
    plain = packed(compress=False)

    for data in (zipped(FILES), plain, packed(), bz2.compress(plain), lzma.compress(plain)):
        assert unpack(data) == FILES


def test_what_programs_leave_behind_is_no_part_of_an_archive():
    left = ("__MACOSX/agent/._model.pb", "agent/._model.pb", ".DS_Store", "agent/Thumbs.db")
    files = FILES | dict.fromkeys(left, b"\0\5\x16\7")

    assert unpack(packed(files)) == unpack(zipped(files)) == FILES


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("../evil", "leads out of the archive"),
        ("..\\evil", "leads out of the archive"),
        ("/etc/passwd", "has an absolute name"),
        ("C:\\windows", "has an absolute name"),
        ("a\x1b[31m", "has a name that is not allowed"),
    ],
)
def test_a_name_in_a_zip_file_that_leads_elsewhere_is_refused(name, reason):
    assert reason in refusal(zipped({name: b"text"}))


def test_links_doubles_bombs_and_lies_in_zip_files_are_refused(monkeypatch):
    link = zipfile.ZipInfo("odd")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    locked = bytearray(zipped({"a": b"text"}))
    for mark, place in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        locked[locked.index(mark) + place] |= 1

    assert "odd is a symbolic link" in refusal(zipped({link: b"/etc/passwd"}))
    assert "is encrypted" in refusal(bytes(locked))
    assert "unpacks to more than 100 times" in refusal(zipped({"zeros": bytes(64 << 20)}))
    assert "is a Python pickle" in refusal(zipped({"model.pb": pickle.dumps({"a": [1, 2]})}))
    with pytest.warns(UserWarning, match="Duplicate name"):
        double = zipped({"a": b"1", zipfile.ZipInfo("a"): b"2"})
    assert "a occurs twice" in refusal(double)
    monkeypatch.setattr(archive, "MOST_MEMBERS", 3)
    assert "has more than 3 members" in refusal(zipped({str(n): b"" for n in range(4)}))


@pytest.mark.parametrize(
    "compression",
    [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA],
)
def test_damage_in_a_zip_file_is_a_fault_and_the_members_before_it_are_kept(compression):
    whole, other = {"a.csv": b"1,2,3\n" * 500}, {"b.csv": bytes(range(256)) * 20}
    data = bytearray(zipped(whole | other, compression))
    start = data.rindex(b"PK\3\4")
    data[start + 40 : start + 80] = b"\xff" * 40

    found, fault = unpack_readable(io.BytesIO(bytes(data)), lambda _: True)

    assert found == whole
    assert "damaged" in str(fault)


def test_a_file_is_read_by_its_path(tmp_path):
    path = tmp_path / "model.tar.gz"
    path.write_bytes(packed())

    assert read_archive(path) == FILES


def test_a_path_that_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    for name, reason in [("none", "cannot be read"), ("pipe", "is not"), ("", "is not")]:
        with pytest.raises(SettingsError, match=reason):
            read_archive(tmp_path / name)
