"""The ROS 2 message types of a bag, as ``.msg`` definitions; standard types as ROS 2 defines them."""

from __future__ import annotations

from typing import Final

_STANDARD: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
}

POSE: Final = "geometry_msgs/msg/PoseStamped"
NEIGHBOURS: Final = "dcp_msgs/msg/NeighbourTable"
VARIABLE: Final = "dcp_msgs/msg/VariableEvent"

_NEIGHBOUR = """\
# A node in a neighbour table.
string node_id                        # in the notation of the profile, such as 02:00:00:00:00:01
builtin_interfaces/Time last_heard    # time of capture of its last beacon
uint32 beacons                        # beacons received since the start of the recording
bool has_report                       # whether a state report was received; if not, the fields below are invalid
uint32 report_seqno                   # sequence number of its last state report
builtin_interfaces/Time report_time   # time of capture of that report
bool has_position                     # whether that report has a finite Cartesian position
geometry_msgs/Point position          # in metres, in the frame of reference of the nodes
"""

#: Type -> its definition.
_OWN: Final = {
    POSE: "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    NEIGHBOURS: """\
# Neighbour table of the recorder: the nodes whose beacons it received within `window`, by identifier.
std_msgs/Header header
float32 window                        # seconds
dcp_msgs/Neighbour[] neighbours
""",
    VARIABLE: """\
# One received VarDis record that creates, updates or deletes a variable.
uint8 CREATE=1
uint8 UPDATE=2
uint8 DELETE=3
std_msgs/Header header                # stamp: time of capture; frame_id is empty
uint64 frame                          # number of the frame in the recording, from 1
string sender                         # node that sent the beacon; empty if unknown
uint8 kind                            # CREATE, UPDATE or DELETE
uint32 var_id
uint32 seqno                          # CREATE, UPDATE: sequence number of the value
uint8[] value                         # CREATE, UPDATE: octets of the value
string prod_id                        # CREATE: producer
string descr                          # CREATE: description; octets that are not UTF-8 are written \\xff
uint32 rep_cnt                        # CREATE: number of beacons that contain each instruction
uint64 timeout_ms                     # CREATE: deleted after this time without an update; 0 = never
""",
}

_DEPENDENCIES: Final = {
    POSE: ("std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Pose", "geometry_msgs/Point",
           "geometry_msgs/Quaternion"),
    NEIGHBOURS: ("std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Point", "dcp_msgs/Neighbour"),
    VARIABLE: ("std_msgs/Header", "builtin_interfaces/Time"),
}  # fmt: skip


def _whole(name: str) -> str:
    """Return a definition with those of all types that it uses, in the form of the encoding ``ros2msg`` of MCAP."""
    parts = {**_STANDARD, "dcp_msgs/Neighbour": _NEIGHBOUR}
    line = "=" * 80
    return _OWN[name] + "".join(f"{line}\nMSG: {other}\n{parts[other]}" for other in _DEPENDENCIES[name])


#: Type -> its definition and those of all types that it uses, as in the schemas of the file.
DEFINITIONS: Final = {name: _whole(name) for name in _OWN}
