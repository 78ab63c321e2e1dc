"""Recordings for tests, written by other people's code: rosbags' CDR, protobuf, and the mcap writer."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore

ROS = get_typestore(Stores.ROS2_HUMBLE)
T = ROS.types


def header(stamp_ns: int, frame: str) -> Any:
    time = T["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def fix(stamp_ns, place, frame="gnss", status=2, cov=None, cov_type=2) -> Any:
    return T["sensor_msgs/msg/NavSatFix"](
        header=header(stamp_ns, frame),
        status=T["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
        latitude=place[0], longitude=place[1], altitude=place[2],
        position_covariance=np.diag([1.0, 4.0, 9.0]).ravel() if cov is None else np.asarray(cov, float),
        position_covariance_type=cov_type,
    )  # fmt: skip


def pose(values: Iterable[float]) -> Any:
    x, y, z, qx, qy, qz, qw = values
    return T["geometry_msgs/msg/Pose"](
        position=T["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=T["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )


def with_covariance(values) -> Any:
    return T["geometry_msgs/msg/PoseWithCovariance"](pose=pose(values), covariance=np.zeros(36))


def odometry(stamp_ns, values, frame="odom", child="base_link") -> Any:
    v = T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = T["geometry_msgs/msg/Twist"](linear=v, angular=v)
    return T["nav_msgs/msg/Odometry"](
        header=header(stamp_ns, frame), child_frame_id=child, pose=with_covariance(values),
        twist=T["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )  # fmt: skip


def pose_stamped(stamp_ns, values, frame="map") -> Any:
    return T["geometry_msgs/msg/PoseStamped"](header=header(stamp_ns, frame), pose=pose(values))


def pose_cov_stamped(stamp_ns, values, frame="map") -> Any:
    return T["geometry_msgs/msg/PoseWithCovarianceStamped"](
        header=header(stamp_ns, frame), pose=with_covariance(values)
    )


def path(stamp_ns, poses, frame="map") -> Any:
    return T["nav_msgs/msg/Path"](header=header(stamp_ns, frame), poses=list(poses))


def transform(stamp_ns, values, parent, child) -> Any:
    x, y, z, qx, qy, qz, qw = values
    return T["geometry_msgs/msg/TransformStamped"](
        header=header(stamp_ns, parent), child_frame_id=child,
        transform=T["geometry_msgs/msg/Transform"](
            translation=T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=T["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
        ),
    )  # fmt: skip


def transforms(items) -> Any:
    return T["tf2_msgs/msg/TFMessage"](transforms=list(items))


def cdr(message: Any, little: bool = True) -> bytes:
    return bytes(ROS.serialize_cdr(message, message.__msgtype__, little_endian=little))


@dataclass
class Layout:
    """How the mcap writer is told to write."""

    compression: CompressionType = CompressionType.ZSTD
    chunked: bool = True
    index: bool = True
    summary: bool = True
    chunk_size: int = 1 << 20
    data_crc: bool = False

    def writer(self, path: Path) -> Writer:
        keep = self.summary
        return Writer(
            str(path), compression=self.compression, use_chunking=self.chunked, chunk_size=self.chunk_size,
            use_statistics=keep, use_summary_offsets=keep, repeat_channels=keep, repeat_schemas=keep,
            enable_data_crcs=self.data_crc,
            index_types=_index_types(self.index),
        )  # fmt: skip


def _index_types(wanted: bool) -> Any:
    return IndexType.ALL if wanted else IndexType.NONE


@dataclass
class Record:
    topic: str
    kind: str
    log_ns: int
    payload: bytes
    encoding: str = "cdr"
    schema_encoding: str = "ros2msg"
    schema: bytes = field(default=b"", repr=False)


def ros_record(topic: str, log_ns: int, message: Any, little: bool = True) -> Record:
    return Record(
        topic, message.__msgtype__, log_ns, cdr(message, little), schema=definition(message.__msgtype__)
    )


@cache
def definition(kind: str) -> bytes:
    return ROS.generate_msgdef(kind, ros_version=2)[0].encode()


def write(path: Path, records: Iterable[Record], layout: Layout | None = None) -> Path:
    writer = (layout or Layout()).writer(path)
    writer.start(profile="ros2")
    schemas: dict[tuple[str, str], int] = {}
    channels: dict[tuple[str, str, str], int] = {}
    for number, record in enumerate(records):
        key = (record.topic, record.kind, record.encoding)
        if key not in channels:
            kind = (record.kind, record.schema_encoding)
            if kind not in schemas:
                schemas[kind] = writer.register_schema(record.kind, record.schema_encoding, record.schema)
            channels[key] = writer.register_channel(record.topic, record.encoding, schemas[kind])
        writer.add_message(channels[key], record.log_ns, record.payload, record.log_ns, number)
    writer.finish()
    return path


# --- Foxglove -----------------------------------------------------------------------------------

_KINDS = {
    "double": descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
    "string": descriptor_pb2.FieldDescriptorProto.TYPE_STRING,
    "enum": descriptor_pb2.FieldDescriptorProto.TYPE_ENUM,
}
_MESSAGES: dict[str, list[tuple[str, int, str, bool]]] = {
    "Vector3": [("x", 1, "double", False), ("y", 2, "double", False), ("z", 3, "double", False)],
    "Quaternion": [(a, i, "double", False) for i, a in enumerate("xyzw", start=1)],
    "Pose": [("position", 1, "Vector3", False), ("orientation", 2, "Quaternion", False)],
    "PoseInFrame": [("timestamp", 1, "T", False), ("frame_id", 2, "string", False), ("pose", 3, "Pose", False)],
    "PosesInFrame": [("timestamp", 1, "T", False), ("frame_id", 2, "string", False), ("poses", 3, "Pose", True)],
    "LocationFix": [
        ("latitude", 1, "double", False), ("longitude", 2, "double", False), ("altitude", 3, "double", False),
        ("position_covariance", 4, "double", True), ("position_covariance_type", 5, "enum", False),
        ("timestamp", 6, "T", False), ("frame_id", 7, "string", False),
    ],
}  # fmt: skip


def foxglove_files() -> descriptor_pb2.FileDescriptorSet:
    """The schemas as Foxglove publishes them, in one file of descriptors, dependency last on purpose."""
    file = descriptor_pb2.FileDescriptorProto(name="foxglove/all.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    enum = file.enum_type.add(name="PositionCovarianceType")
    for number, name in enumerate(("UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN")):
        enum.value.add(name=name, number=number)
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for field_name, number, kind, repeated in fields:
            entry = message.field.add(name=field_name, number=number, label=3 if repeated else 1)
            entry.type = _KINDS.get(kind, descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE)
            if kind == "T":
                entry.type_name = ".google.protobuf.Timestamp"
            elif kind == "enum":
                entry.type_name = ".foxglove.PositionCovarianceType"
            elif kind not in _KINDS:
                entry.type_name = f".foxglove.{kind}"
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return descriptor_pb2.FileDescriptorSet(file=[file, stamp])


def foxglove_record(topic: str, kind: str, log_ns: int, content: dict[str, Any], encoding: str) -> Record:
    """`content` is the JSON form with timestamp as {sec, nsec}."""
    if encoding == "json":
        payload, schema = json.dumps(content).encode(), b"{}"
        return Record(topic, f"foxglove.{kind}", log_ns, payload, "json", "jsonschema", schema)
    files = foxglove_files()
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(files.file):
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{kind}"))()
    _fill(message, content)
    schema = files.SerializeToString()
    return Record(
        topic, f"foxglove.{kind}", log_ns, message.SerializeToString(), "protobuf", "protobuf", schema
    )


def _fill(message: Any, content: dict[str, Any]) -> None:
    for key, value in content.items():
        name = {"sec": "seconds", "nsec": "nanos"}.get(key, key)
        if isinstance(value, dict):
            _fill(getattr(message, name), value)
            getattr(message, name).SetInParent()
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                _fill(getattr(message, name).add(), item)
        elif isinstance(value, list):
            getattr(message, name).extend(value)
        else:
            setattr(message, name, value)
