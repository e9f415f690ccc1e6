"""Recordings for the tests of reports, and what is in a page."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path

from dcp_tables.report.recorded import Recorded, gather

from dcp_codec import get_codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.framing.envelope import Envelope
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
CODEC = get_codec("dcp-2.0")
START = 1_790_000_000_000_000_000
OTHER = (Payload(99, b"data"),)
SRP, VARDIS = 1, 2
UPDATES, DELETES, SUMMARIES, CREATES = 2, 6, 1, 5

Sent = tuple[float, int, int, tuple[Payload, ...]]


def address(node: int) -> bytes:
    return bytes([2, 0, 0, 0, 0, node])


def name(node: int) -> str:
    return address(node).hex(":")


def report(node: int, seqno: int, x: float = 1.0, y: float = 2.0, z: float = 3.0) -> Payload:
    place = CODEC.safety_data_type(x=x, y=y, z=z)
    return Payload(SRP, ExtendedSafetyData(place, address(node), 0, seqno))


def create(
    variable: int, producer: int, value: bytes, descr: str = "a variable", at: int = 0, seqno: int = 0
) -> Payload:
    spec = VarSpec(variable, address(producer), 1, descr.encode(), at, 0)
    return Payload(VARDIS, (Container(CREATES, (VarCreate(spec, VarUpdate(variable, seqno, value)),)),))


def update(variable: int, seqno: int, value: bytes) -> Payload:
    return Payload(VARDIS, (Container(UPDATES, (VarUpdate(variable, seqno, value),)),))


def summary(variable: int, seqno: int) -> Payload:
    return Payload(VARDIS, (Container(SUMMARIES, (VarSumm(variable, seqno),)),))


def ask(variable: int) -> Payload:
    return Payload(VARDIS, (Container(4, (VarReqCreate(variable),)),))


def delete(variable: int) -> Payload:
    return Payload(VARDIS, (Container(DELETES, (VarDelete(variable),)),))


def record(path: Path, sent: Iterable[Sent], damaged: Iterable[float] = ()) -> Path:
    """A recording of beacons (seconds, node, sequence number, payloads), and of some that are cut off."""
    envelope = Envelope(CODEC.profile.link)
    frames = []
    for seconds, node, seqno, payloads in sent:
        octets = CODEC.encode(Beacon(BPHeader(address(node), seqno, 1), payloads))
        frames.append((seconds, envelope.frame(octets, address(node))))
    whole = CODEC.encode(Beacon(BPHeader(address(1), 0, 1), (report(1, 0),)))
    frames += [(seconds, envelope.frame(whole[:-9], address(1))) for seconds in damaged]
    with create_capture(path) as writer:
        for number, (seconds, data) in enumerate(sorted(frames), start=1):
            writer.write(Frame(number, START + round(seconds * 1e9), data, len(data)))
    return path


def gathered(path: Path) -> Recorded:
    return gather(str(path), "dcp-2.0", None)


def steady(node: int, seconds: float, skipped: Iterable[int] = ()) -> list[Sent]:
    """Ten beacons a second with state reports; without some of the numbers."""
    numbers = sorted(set(range(round(seconds * 10))) - set(skipped))
    return [(n / 10 + node / 1000, node, n, (report(node, n),)) for n in numbers]


class Page(HTMLParser):
    """Contents of a page: elements with their attributes, and text outside of scripts and style sheets."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside not in ("script", "style"):
            self.text += data

    def many(self, tag: str) -> int:
        return sum(found == tag for found, _ in self.elements)


def self_contained(text: str) -> Page:
    """Nothing in the page is anywhere else, and what it refers to within itself is there, once."""
    page = Page(text)
    assert "default-src 'none'" in text
    assert "@import" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs in page.elements:
        assert tag not in ("link", "img", "iframe", "object", "image")
        assert "src" not in attrs
        assert not any(each.startswith("on") for each in attrs)
        for name in ("href", "aria-labelledby"):
            if name in attrs:
                assert str(attrs[name]).removeprefix("#") in ids
        if "href" in attrs:
            assert str(attrs["href"]).startswith("#")
    return page
