"""Checkpoint files: the bytes are TensorFlow's, and damage is said with file and reason."""

import struct

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.convert.tensorflow.bundle import (
    DATA,
    INDEX,
    data_names,
    masked_crc,
    open_bundle,
    read_bundle,
    read_table,
    write_bundle,
    write_table,
)
from drcli.convert.tensorflow.graph import BundleEntryMessage, BundleHeaderMessage

SCOPE = "main_level/agent/main/online/"

GOLDEN = {
    "global_step": np.array(12, np.int64),
    f"{SCOPE}network_0/gradients_from_head_0-0_rescalers": np.array(1.0, np.float32),
    f"{SCOPE}network_1/x/bias": np.array([1, 2, 3], np.float32),
    f"{SCOPE}network_1/x/kernel": np.arange(6, dtype=np.float32).reshape(2, 3),
}
"""What tf.compat.v1.train.Saver of TensorFlow 2.12.1 wrote into the two files below."""

GOLDEN_INDEX = bytes.fromhex(
    "00000608011a020801000b0b676c6f62616c5f7374657008091200280835f4c8fe0a00480d6d61696e5f6c6576656c"
    "2f6167656e742f6d61696e2f6f6e6c696e652f6e6574776f726b5f302f6772616469656e74735f66726f6d5f686561"
    "645f302d305f72657363616c65727308011200200828043581a5da2b250811312f782f626961730801120412020803"
    "200c280c35735b89712906156b65726e656c0801120812020802120208032018281835c0db3d170000000001000000"
    "00b86e677a000000000100000000c0f2a1b00001036e00bc0100000000010000000014e0c084c10108ce010f000000"
    "0000000000000000000000000000000000000000000000000000000000000057fb808b247547db"
)
GOLDEN_DATA = bytes.fromhex(
    "0c000000000000000000803f0000803f0000004000004040000000000000803f0000004000004040000080400000a0"
    "40"
)


def test_files_of_tensorflow_are_read():
    found = read_bundle(GOLDEN_INDEX, GOLDEN_DATA, "x.ckpt")

    assert found.keys() == GOLDEN.keys()
    for name, values in GOLDEN.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values, strict=True)


def test_files_are_written_byte_for_byte_as_tensorflow_does():
    assert write_bundle(GOLDEN) == (GOLDEN_INDEX, GOLDEN_DATA)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16, np.int32, np.int64])
def test_all_types_and_shapes_come_back(dtype):
    tensors = {
        "scalar": np.array(3, dtype),
        "empty": np.zeros((0, 4), dtype),
        "turned": np.arange(24).astype(dtype).reshape(2, 3, 4).transpose(2, 0, 1),
    }

    found = read_bundle(*write_bundle(tensors), "x.ckpt")

    for name, values in tensors.items():
        np.testing.assert_array_equal(found[name], values, strict=True)


def test_many_tensors_fill_several_blocks():
    # 9,000 names of 60 bytes need about 300 kB, and a block has 256.
    tensors = {
        f"{SCOPE}{number * 7919 % 20011:05d}/{'kernel' * 4}": np.array([number], np.float32)
        for number in range(9000)
    }
    index, data = write_bundle(tensors)

    found = read_bundle(index, data, "x.ckpt")

    assert len(index) > 1 << 18
    assert {name: float(values[0]) for name, values in found.items()} == {
        name: float(values[0]) for name, values in tensors.items()
    }


def test_a_type_that_is_not_written_is_an_error():
    with pytest.raises(ValueError, match="complex64 cannot be written"):
        write_bundle({"x": np.zeros(2, np.complex64)})


@pytest.mark.parametrize("cut", [0, 1, 20, 47])
def test_a_truncated_data_file_is_refused_with_its_name(cut):
    with pytest.raises(SettingsError, match=r"a/5_Step-5\.ckpt\.data-00000-of-00001 is damaged"):
        read_bundle(GOLDEN_INDEX, GOLDEN_DATA[:cut], "a/5_Step-5.ckpt")


def test_a_wrong_checksum_names_the_tensor():
    altered = bytearray(GOLDEN_DATA)
    altered[13] ^= 1

    with pytest.raises(SettingsError, match=r"checksum \(CRC-32C\) of .*network_1/x/bias is wrong"):
        read_bundle(GOLDEN_INDEX, bytes(altered), "x.ckpt")


def test_the_name_for_messages_may_end_with_index():
    assert open_bundle(GOLDEN_INDEX, "m/x.ckpt.index").data_names == [f"m/x.ckpt{DATA}"]


def test_several_data_files_are_read_in_order():
    index = changed(num_shards=2, shards={f"{SCOPE}network_1/x/bias": (1, 0)})
    first, second = GOLDEN_DATA, GOLDEN_DATA[12:24]

    found = read_bundle(index, [first, second], "x.ckpt")

    np.testing.assert_array_equal(found[f"{SCOPE}network_1/x/bias"], [1, 2, 3])
    assert data_names("x.ckpt", 2)[1] == "x.ckpt.data-00001-of-00002"


def test_a_missing_data_file_is_named():
    index = changed(num_shards=2)

    with pytest.raises(SettingsError, match="has 2 data files, and 1 of them are here") as caught:
        read_bundle(index, GOLDEN_DATA, "x.ckpt")

    assert "x.ckpt.data-00001-of-00002" in caught.value.remedy


def test_tensors_of_other_processors_are_turned_around():
    values = np.array([1.5, -2.0], ">f4").tobytes()
    entry = BundleEntryMessage(dtype=1, size=8, crc32c=masked_crc(values))
    entry.shape.dim.add(size=2)
    header = BundleHeaderMessage(num_shards=1, endianness=1)
    index = write_table({b"": header.SerializeToString(), b"x": entry.SerializeToString()})

    found = read_bundle(index, values, "x.ckpt")["x"]

    np.testing.assert_array_equal(found, np.array([1.5, -2.0], np.float32), strict=True)


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"size": 20}, "has 20 bytes, which do not fit its shape [3]"),
        ({"sizes": (-1,)}, "has no definite shape"),
        ({"sizes": (3, 1 << 60, 1 << 60)}, "do not fit its shape"),
        ({"offset": -4}, "is at an impossible place"),
        ({"offset": 1 << 40}, "ends at byte 1099511627788, and the file has 48"),
        ({"shard_id": 5}, "is at an impossible place"),
        ({"dtype": 7}, "values of the type text, which no weight of a policy has"),
        ({"dtype": 14}, "values of the type bfloat16"),
        ({"dtype": 99}, "values of the type 99"),
    ],
)
def test_entries_that_cannot_be_are_refused(fields, fault):
    with pytest.raises(SettingsError) as caught:
        read_bundle(changed(entry=fields), GOLDEN_DATA, "x.ckpt")

    assert fault in str(caught.value)
    assert "network_1/x/bias" in str(caught.value)


def test_a_partitioned_variable_is_named_as_such():
    with pytest.raises(SettingsError, match="stored in 2 slices of a partitioned variable"):
        read_bundle(changed(entry={"slices": 2}), GOLDEN_DATA, "x.ckpt")


def test_tensors_that_share_bytes_cannot_fill_the_memory():
    tensors = {f"x{number}": np.zeros(1000, np.float32) for number in range(100)}
    index, data = write_bundle(tensors)
    table = read_table(index, "x")
    for key, value in table.items():
        if key:
            entry = BundleEntryMessage.FromString(value)
            entry.offset = 0
            table[key] = entry.SerializeToString()

    with pytest.raises(SettingsError, match="its tensors have more bytes than the data"):
        read_bundle(write_table(table), data[:4000], "x.ckpt")


def test_an_index_without_a_header_or_of_a_newer_format_is_refused():
    table = read_table(GOLDEN_INDEX, "x")
    del table[b""]
    with pytest.raises(SettingsError, match=r"x\.ckpt\.index is damaged: it has no header"):
        open_bundle(write_table(table), "x.ckpt")

    header = BundleHeaderMessage(num_shards=1)
    header.version.min_consumer = 3
    table[b""] = header.SerializeToString()
    with pytest.raises(SettingsError, match="version 3 of the format, which is newer"):
        open_bundle(write_table(table), "x.ckpt")

    table[b""] = BundleHeaderMessage(num_shards=0).SerializeToString()
    with pytest.raises(SettingsError, match="it claims 0 data files"):
        open_bundle(write_table(table), "x.ckpt")


@pytest.mark.parametrize("key", [b"\xff\xfe", b"x"])
def test_an_entry_that_is_no_message_is_refused(key):
    table = read_table(GOLDEN_INDEX, "x") | {key: b"\xff\xff\xff"}

    with pytest.raises(
        SettingsError, match=r"x\.ckpt\.index is damaged: its entry .* cannot be read"
    ):
        open_bundle(write_table(table), "x.ckpt")


def test_a_pickle_is_refused_and_not_opened():
    pickle = b"\x80\x04cos\nsystem\n(S'touch pwned'\ntR." + struct.pack("<Q", 0) * 20

    with pytest.raises(SettingsError, match="is not the index of a TensorFlow checkpoint"):
        open_bundle(pickle, f"x.ckpt{INDEX}")


def test_tensorflow_reads_our_files_and_we_read_those_of_its_saver(tmp_path):
    tensorflow = pytest.importorskip("tensorflow", reason="TensorFlow is not installed.")
    index, data = write_bundle(GOLDEN)
    (tmp_path / f"x.ckpt{INDEX}").write_bytes(index)
    (tmp_path / f"x.ckpt{DATA}").write_bytes(data)

    reader = tensorflow.train.load_checkpoint(str(tmp_path / "x.ckpt"))
    for name, values in GOLDEN.items():
        np.testing.assert_array_equal(reader.get_tensor(name), values)
    tensorflow.raw_ops.SaveV2(
        prefix=str(tmp_path / "theirs.ckpt"),
        tensor_names=list(GOLDEN),
        shape_and_slices=[""] * len(GOLDEN),
        tensors=list(GOLDEN.values()),
    )
    theirs = [(tmp_path / f"theirs.ckpt{end}").read_bytes() for end in (INDEX, DATA)]
    for name, values in read_bundle(*theirs, "theirs.ckpt").items():
        np.testing.assert_array_equal(values, GOLDEN[name])


def changed(*, num_shards=1, shards=None, entry=None):
    """The golden index with other values in its header, or in the entry of one tensor."""
    table = read_table(GOLDEN_INDEX, "golden")
    header = BundleHeaderMessage.FromString(table[b""])
    header.num_shards = num_shards
    table[b""] = header.SerializeToString()
    for name, (shard, offset) in (shards or {}).items():
        moved = BundleEntryMessage.FromString(table[name.encode()])
        moved.shard_id, moved.offset = shard, offset
        table[name.encode()] = moved.SerializeToString()
    if entry is not None:
        key = f"{SCOPE}network_1/x/bias".encode()
        message = BundleEntryMessage.FromString(table[key])
        for name, value in entry.items():
            if name == "sizes":
                del message.shape.dim[:]
                for size in value:
                    message.shape.dim.add(size=size)
            elif name == "slices":
                for _ in range(value):
                    message.slices.add()
            else:
                setattr(message, name, value)
        table[key] = message.SerializeToString()
    return write_table(table)
