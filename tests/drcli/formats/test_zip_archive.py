"""ZIP archives that are damaged are read as far as they can be."""

import io
import zipfile

import pytest

from drcli.formats.zip_archive import unzip_readable


@pytest.mark.parametrize(
    "compression",
    [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA],
)
def test_damage_in_a_member_is_a_fault_and_the_members_before_it_are_kept(compression):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        archive.writestr("a.csv", b"1,2,3\n" * 500)
        start = file.tell()
        archive.writestr("b.csv", bytes(range(256)) * 20)
    data = bytearray(file.getvalue())
    data[start + 40 : start + 80] = b"\xff" * 40

    found, fault = unzip_readable(io.BytesIO(bytes(data)), lambda _: True)

    assert found == {"a.csv": b"1,2,3\n" * 500}
    assert "damaged" in str(fault)
