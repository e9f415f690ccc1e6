"""The bench hands out names on a clock that does not stand still between two looks at it."""

from __future__ import annotations

from dcp_conformance.bench import Bench, Session
from dcp_conformance.pics import Pics
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, reference_config

from .rig import codec_of, known_cases


class Ticking(VirtualLowerTester):
    """Every look at the clock takes 100 ns."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.ticks = 0

    def now(self) -> int:
        self.ticks += 100
        return super().now() + self.ticks


def test_unknown_names_are_found_while_time_passes():
    codec = codec_of("dcp-2.0")
    session = Session(codec, Ticking(InProcess(reference_config(codec))), None, Pics())
    bench = Bench(session, next(iter(known_cases().values())))
    session.leaving = {200: 1 << 60, 201: 0}
    session.known = {200, 201}
    names = bench.unknown_ids(60)
    assert 200 not in names
    assert 201 in names
    assert session.leaving == {200: 1 << 60}
