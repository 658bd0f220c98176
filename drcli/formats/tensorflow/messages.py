"""TensorFlow's protobuf messages, as far as needed; other fields are skipped.

Source: TensorFlow's `graph.proto`, `node_def.proto`, `attr_value.proto`, `tensor.proto`,
`tensor_shape.proto`, `versions.proto`, `meta_graph.proto`, `saver.proto`, `tensor_bundle.proto`.
"""

from enum import IntEnum
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_PACKAGE = "drcli.tensorflow"
_SCALARS = descriptor_pb2.FieldDescriptorProto

_TYPES = {
    "bool": _SCALARS.TYPE_BOOL,
    "bytes": _SCALARS.TYPE_BYTES,
    "double": _SCALARS.TYPE_DOUBLE,
    "fixed32": _SCALARS.TYPE_FIXED32,
    "float": _SCALARS.TYPE_FLOAT,
    "int32": _SCALARS.TYPE_INT32,
    "int64": _SCALARS.TYPE_INT64,
    "string": _SCALARS.TYPE_STRING,
}

_FIELDS: dict[str, tuple[str, ...]] = {
    "Dim": ("1 size int64", "2 name string"),
    "TensorShape": ("2 dim *Dim", "3 unknown_rank bool"),
    "Tensor": (
        "1 dtype int32",
        "2 tensor_shape TensorShape",
        "3 version_number int32",
        "4 tensor_content bytes",
        "5 float_val *float",
        "6 double_val *double",
        "7 int_val *int32",
        "8 string_val *bytes",
        "10 int64_val *int64",
        "13 half_val *int32",
    ),
    "ListValue": ("2 s *bytes", "3 i *int64", "4 f *float", "5 b *bool", "6 type *int32"),
    "AttrValue": (
        "1 list ListValue",
        "2 s bytes",
        "3 i int64",
        "4 f float",
        "5 b bool",
        "6 type int32",
        "7 shape TensorShape",
        "8 tensor Tensor",
    ),
    "Attr": ("1 key string", "2 value AttrValue"),
    "Node": ("1 name string", "2 op string", "3 input *string", "4 device string", "5 attr *Attr"),
    "Versions": ("1 producer int32", "2 min_consumer int32"),
    "Graph": ("1 node *Node", "4 versions Versions"),
    "MetaInfo": ("4 tags *string", "5 tensorflow_version string"),
    "Saver": (
        "1 filename_tensor_name string",
        "2 save_tensor_name string",
        "3 restore_op_name string",
        "4 max_to_keep int32",
        "5 sharded bool",
        "7 version int32",
    ),
    "MetaGraph": ("1 meta_info_def MetaInfo", "2 graph_def Graph", "3 saver_def Saver"),
    "BundleHeader": ("1 num_shards int32", "2 endianness int32", "3 version Versions"),
    "Extent": ("1 start int64", "2 length int64"),
    "Slice": ("1 extent *Extent",),
    "BundleEntry": (
        "1 dtype int32",
        "2 shape TensorShape",
        "3 shard_id int32",
        "4 offset int64",
        "5 size int64",
        "6 crc32c fixed32",
        "7 slices *Slice",
    ),
}
"""`*`: repeated. A node's attributes are a map in TensorFlow, which protobuf writes like repeated
pairs.
"""

_CHOICES = {"AttrValue": "value"}


class DataType(IntEnum):
    """Source: TensorFlow's `types.proto`."""

    FLOAT = 1
    DOUBLE = 2
    INT32 = 3
    INT64 = 9
    HALF = 19


def _message(name: str, fields: tuple[str, ...]) -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=name)
    if name in _CHOICES:
        message.oneof_decl.add(name=_CHOICES[name])
    for written in fields:
        number, field_name, kind = written.split()
        field = message.field.add(name=field_name, number=int(number))
        repeated, kind = kind.startswith("*"), kind.lstrip("*")
        field.label = _SCALARS.LABEL_REPEATED if repeated else _SCALARS.LABEL_OPTIONAL
        if kind in _TYPES:
            field.type = _TYPES[kind]
        else:
            field.type, field.type_name = _SCALARS.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
        if name in _CHOICES:
            field.oneof_index = 0
    return message


def _classes() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(
        name="drcli/tensorflow.proto",
        package=_PACKAGE,
        syntax="proto3",
        message_type=[_message(name, fields) for name, fields in _FIELDS.items()],
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))
        for name in _FIELDS
    }


_messages = _classes()

AttrValueMessage: Any = _messages["AttrValue"]
BundleEntryMessage: Any = _messages["BundleEntry"]
BundleHeaderMessage: Any = _messages["BundleHeader"]
GraphMessage: Any = _messages["Graph"]
MetaGraphMessage: Any = _messages["MetaGraph"]
TensorMessage: Any = _messages["Tensor"]
TensorShapeMessage: Any = _messages["TensorShape"]
