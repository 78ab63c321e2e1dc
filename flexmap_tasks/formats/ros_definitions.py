"""ROS 2 message definitions (common_interfaces, Apache-2.0) in the form MCAP carries them."""

from __future__ import annotations

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_POINT = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
_PARTS = {
    "builtin_interfaces/Time": _TIME,
    "std_msgs/Header": _HEADER,
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\nint8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "uint16 service\n"
    ),
    "geometry_msgs/Point": _POINT,
    "geometry_msgs/Vector3": _POINT,
    "geometry_msgs/Quaternion": _QUATERNION,
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "sensor_msgs/PointField": (
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n"
        "uint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
    ),
}


def _definition(body: str, *parts: str) -> str:
    """The message's own fields, then every type it uses."""
    rule = "=" * 80 + "\n"
    return body + "".join(f"{rule}MSG: {name}\n{_PARTS[name]}" for name in parts)


DEFINITIONS = {
    "sensor_msgs/msg/NavSatFix": _definition(
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\n"
        "uint8 COVARIANCE_TYPE_APPROXIMATED=1\nuint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\n"
        "uint8 COVARIANCE_TYPE_KNOWN=3\nuint8 position_covariance_type\n",
        "std_msgs/Header", "builtin_interfaces/Time", "sensor_msgs/NavSatStatus",
    ),
    "nav_msgs/msg/Odometry": _definition(
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n",
        "std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/TwistWithCovariance", "geometry_msgs/Pose", "geometry_msgs/Twist", "geometry_msgs/Point",
        "geometry_msgs/Quaternion", "geometry_msgs/Vector3",
    ),
    "sensor_msgs/msg/PointCloud2": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        "std_msgs/Header", "builtin_interfaces/Time", "sensor_msgs/PointField",
    ),
}  # fmt: skip
"""Definition by the type's full name."""
