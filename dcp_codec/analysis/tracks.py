"""Positions of nodes over time, from the state reports of a recording, as CSV, GPX or KML.

SafetyData has local coordinates: x is taken as metres to the east, y to the north and z up of a reference point. GPX
and KML need degrees, and therefore the reference point; the conversion is exact for the WGS 84 ellipsoid.
"""

from __future__ import annotations

import csv
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import IO

import msgspec
from dcp_spec.profile.definition import Profile

from dcp_codec.common.spreadsheet import safe_cell
from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.jsonform import node_id_text

_AXES = ("position.x", "position.y", "position.z")
#: WGS 84: semi-major axis in m, flattening.
_A, _F = 6_378_137.0, 1 / 298.257223563
_E2 = _F * (2 - _F)


class TrackError(ValueError):
    """Positions cannot be determined or not be written in this format. The message gives the reason."""


class Reference(msgspec.Struct, frozen=True):
    """The origin of local coordinates: degrees, and metres above the ellipsoid."""

    latitude: float
    longitude: float
    altitude: float = 0.0


class Position(msgspec.Struct, frozen=True, gc=False):
    """A position that a node reported; ``time_ns`` is the time of capture."""

    time_ns: int
    node: str
    seqno: int
    x: float
    y: float
    z: float


def parse_reference(text: str) -> Reference:
    """Parse ``LAT,LON`` or ``LAT,LON,ALT`` (degrees, metres). Raises ValueError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{text!r} is not LAT,LON or LAT,LON,ALT, such as -43.52,172.58,20")
    if abs(numbers[0]) > 90 or abs(numbers[1]) > 180:
        raise ValueError(f"{text!r}: latitude must be within -90 to 90 degrees, longitude within -180 to 180")
    return Reference(*numbers)


class Positions:
    """Extracts positions from frames. Raises :class:`TrackError` for a profile whose state reports have none."""

    def __init__(self, profile: Profile) -> None:
        fields = {field.role: field.name for field in profile.srp.safety_data if field.role in _AXES}
        if not profile.srp.is_report or _AXES[0] not in fields or _AXES[1] not in fields:
            raise TrackError(
                f"profile {profile.name} has no positions: no field of srp.safety_data has the role position.x and "
                "position.y (docs/profile-reference.md)"
            )
        self._fields = fields
        self._representation = profile.types.node_id.representation

    def of(self, frame: DissectedFrame) -> Iterator[Position]:
        """Yield the positions in one frame; damaged and non-finite ones are left out."""
        for payload in frame.payloads:
            report = payload.child("srp")
            data = report.child("sData") if report is not None else None
            node = report.child("nodeId") if report is not None else None
            seqno = report.child("seqno") if report is not None else None
            if data is None or node is None or node.value is None or seqno is None or seqno.value is None:
                continue
            # A profile may have no height.
            parts = [data.child(self._fields[axis]) for axis in _AXES if axis in self._fields]
            values = [float(part.value) for part in parts if part is not None and part.value is not None]
            if len(values) < len(parts) or not all(map(math.isfinite, values)):
                continue
            name = node_id_text(node.value, self._representation)
            x, y, z = (*values, 0.0)[:3]
            yield Position(frame.frame.time_ns, name, seqno.value, x, y, z)


def degrees(position: Position, reference: Reference) -> tuple[float, float, float]:
    """Return latitude and longitude in degrees, and altitude in m, of a local position."""
    latitude, longitude = math.radians(reference.latitude), math.radians(reference.longitude)
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    sin_lon, cos_lon = math.sin(longitude), math.cos(longitude)
    normal = _A / math.sqrt(1 - _E2 * sin_lat**2)
    east, north, up = position.x, position.y, position.z
    x = (normal + reference.altitude) * cos_lat * cos_lon - sin_lon * east - sin_lat * cos_lon * north
    y = (normal + reference.altitude) * cos_lat * sin_lon + cos_lon * east - sin_lat * sin_lon * north
    z = (normal * (1 - _E2) + reference.altitude) * sin_lat + cos_lat * north
    x, y, z = x + cos_lat * cos_lon * up, y + cos_lat * sin_lon * up, z + sin_lat * up
    # Bowring's iteration: two rounds are exact to a micrometre near the ground.
    across = math.hypot(x, y)
    found = math.atan2(z, across * (1 - _E2))
    for _ in range(4):
        normal = _A / math.sqrt(1 - _E2 * math.sin(found) ** 2)
        found = math.atan2(z + _E2 * normal * math.sin(found), across)
    sin_found, cos_found = math.sin(found), math.cos(found)
    normal = _A / math.sqrt(1 - _E2 * sin_found**2)
    altitude = across * cos_found + z * sin_found - _A**2 / normal
    return math.degrees(found), math.degrees(math.atan2(y, x)), altitude


def write_csv(positions: Iterable[Position], file: IO[str], reference: Reference | None) -> int:
    """Write one row for each position; with a reference also latitude, longitude and altitude. Return the number of
    rows.
    """
    writer = csv.writer(file, lineterminator="\n")
    more = ("latitude", "longitude", "altitude") if reference is not None else ()
    writer.writerow(("time_ns", "node", "seqno", "x", "y", "z", *more))
    count = 0
    for each in positions:
        found = degrees(each, reference) if reference is not None else ()
        # Textual identifiers are received from the network; a spreadsheet must not evaluate one as a formula.
        node = safe_cell(each.node)
        rounded = [round(value, 9) for value in found[:2]] + [round(value, 3) for value in found[2:]]
        writer.writerow((each.time_ns, node, each.seqno, each.x, each.y, each.z, *rounded))
        count += 1
    return count


def write_gpx(positions: Iterable[Position], file: IO[bytes], reference: Reference) -> int:
    """Write a GPX 1.1 file with one track for each node. Return the number of positions."""
    root = ET.Element("gpx", {"version": "1.1", "creator": "dcp-codec", "xmlns": "http://www.topografix.com/GPX/1/1"})
    count = 0
    for node, track in _by_node(positions).items():
        element = ET.SubElement(root, "trk")
        ET.SubElement(element, "name").text = node
        segment = ET.SubElement(element, "trkseg")
        for each in track:
            latitude, longitude, altitude = degrees(each, reference)
            point = ET.SubElement(segment, "trkpt", {"lat": f"{latitude:.9f}", "lon": f"{longitude:.9f}"})
            ET.SubElement(point, "ele").text = f"{altitude:.3f}"
            ET.SubElement(point, "time").text = _utc(each.time_ns)
            count += 1
    ET.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)
    return count


def write_kml(positions: Iterable[Position], file: IO[bytes], reference: Reference) -> int:
    """Write a KML 2.2 file with one timed track for each node. Return the number of positions."""
    spaces = {"xmlns": "http://www.opengis.net/kml/2.2", "xmlns:gx": "http://www.google.com/kml/ext/2.2"}
    root = ET.Element("kml", spaces)
    document = ET.SubElement(root, "Document")
    count = 0
    for node, track in _by_node(positions).items():
        place = ET.SubElement(document, "Placemark")
        ET.SubElement(place, "name").text = node
        line = ET.SubElement(place, "gx:Track")
        ET.SubElement(line, "altitudeMode").text = "absolute"
        for each in track:
            ET.SubElement(line, "when").text = _utc(each.time_ns)
        for each in track:
            latitude, longitude, altitude = degrees(each, reference)
            ET.SubElement(line, "gx:coord").text = f"{longitude:.9f} {latitude:.9f} {altitude:.3f}"
            count += 1
    ET.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)
    return count


def _by_node(positions: Iterable[Position]) -> dict[str, list[Position]]:
    found: dict[str, list[Position]] = {}
    for each in positions:
        # XML does not allow control characters, which textual identifiers can contain.
        node = "".join(character if character.isprintable() else "?" for character in each.node)
        found.setdefault(node, []).append(each)
    return found


def _utc(time_ns: int) -> str:
    whole, rest = divmod(time_ns, 10**9)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 10**6:03d}Z"
