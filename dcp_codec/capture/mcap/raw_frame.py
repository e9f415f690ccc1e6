"""The message for a raw frame in an MCAP file: ``dcp.RawFrame``, a protobuf message on its own topic.

Protobuf is used because Foxglove and the ``mcap`` command decode it without extensions, octets stay octets, and the
schema in the file describes every field. docs/mcap.md has the definition in protobuf's language.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.message import DecodeError

from dcp_codec.capture.frame import ETHERNET, Frame

TOPIC: Final = "/dcp/frames"
SCHEMA_NAME: Final = "dcp.RawFrame"
SCHEMA_ENCODING: Final = "protobuf"
MESSAGE_ENCODING: Final = "protobuf"

_SECOND = 1_000_000_000
_FILE_NAME = "dcp/RawFrame.proto"
_TIMESTAMP = "google/protobuf/timestamp.proto"
_MOST = 2**62

_Field = descriptor_pb2.FieldDescriptorProto
#: Name and type of each field; the number of a field is its position, from 1. All have explicit presence, so a writer
#: includes a 0 like any other number.
FIELDS: Final = (
    ("timestamp", _Field.TYPE_MESSAGE),
    ("number", _Field.TYPE_UINT64),
    ("interface", _Field.TYPE_UINT32),
    ("link_type", _Field.TYPE_UINT32),
    ("orig_len", _Field.TYPE_UINT32),
    ("data", _Field.TYPE_BYTES),
)


class RawFrame(NamedTuple):
    """The fields of a message. Only `data` is required, so that files of other writers with fewer fields can be
    read.
    """

    data: bytes
    #: Time of capture in ns since 1970; None: the log time.
    time_ns: int | None = None
    #: Number of the frame in the original capture, from 1; 0 for none.
    number: int = 0
    interface: int = 0
    link_type: int = ETHERNET
    #: Length of the frame on the wire in octets; 0: as many as `data` has.
    orig_len: int = 0


def _definition() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(name=_FILE_NAME, package="dcp", syntax="proto3", dependency=[_TIMESTAMP])
    message = file.message_type.add(name=SCHEMA_NAME.removeprefix("dcp."))
    for number, (name, kind) in enumerate(FIELDS, start=1):
        field = message.field.add(name=name, number=number, type=kind, label=_Field.LABEL_OPTIONAL)
        if kind == _Field.TYPE_MESSAGE:
            field.type_name = ".google.protobuf.Timestamp"
        else:
            # In a descriptor, the presence of a scalar field is expressed as a oneof with one member.
            field.proto3_optional = True
            field.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")
    return file


def schema_octets() -> bytes:
    """Return the schema as MCAP requires it: the definition and its imports, as a FileDescriptorSet."""
    timestamp = descriptor_pb2.FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    found: bytes = descriptor_pb2.FileDescriptorSet(file=[timestamp, _definition()]).SerializeToString(
        deterministic=True
    )
    return found


@cache
def _message_class() -> Any:
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(_definition().SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(SCHEMA_NAME))


def encode(frame: Frame) -> bytes:
    """Encode a frame as a message, its fields in the order of their numbers.

    The message has no timestamp: the time of capture is its log time, and a second copy would add a tenth to the size
    of a file.
    """
    message = _message_class()(
        number=frame.number,
        interface=frame.interface,
        link_type=ETHERNET,
        orig_len=frame.orig_len,
        data=frame.data,
    )
    found: bytes = message.SerializeToString()
    return found


def decode(octets: bytes | memoryview) -> RawFrame:
    """Decode the message in `octets`. Raises `ValueError` if it is not such a message or has impossible values."""
    try:
        message = _message_class().FromString(bytes(octets))
    except DecodeError as error:
        raise ValueError(f"it is not a protobuf message {SCHEMA_NAME}: {error}") from None
    if not message.HasField("data"):
        raise ValueError("it has no data")
    time_ns = None
    if message.HasField("timestamp"):
        stamp = message.timestamp
        if stamp.seconds < 0 or stamp.nanos < 0:
            raise ValueError("its timestamp is before 1970")
        time_ns = stamp.seconds * _SECOND + stamp.nanos
    if message.number > _MOST:
        raise ValueError(f"its number is above {_MOST}")
    link_type = message.link_type if message.HasField("link_type") else ETHERNET
    return RawFrame(message.data, time_ns, message.number, message.interface, link_type, message.orig_len)
