"""Stations that do not belong: other versions, clocks that differ, a babbling and a malformed-sending station."""

from __future__ import annotations

from dcp_conformance.frames.builder import FrameBuilder

from dcp_codec.values import VarSumm
from dcp_lab.interop.definition import BUS_4, LINE_3, LINE_5, PAIR, network_test
from dcp_lab.interop.scene import SECOND, Scene


@network_test(
    "IT_NET_CLOCKS",
    "Stations whose clocks are hours apart exchange variables like any others",
    requirements="VD-PC-07 VD-PU-07",
    shapes=(PAIR, LINE_3, LINE_5),
    virtual_only="the clock of a single process cannot be set",
)
def clocks(scene: Scene) -> None:
    for place in scene.places:
        scene.world.set_clock(place, (place % 3 - 1) * 7200 * SECOND)
    scene.start()
    for place in scene.places:
        if scene.can(place, "RTDB-Create") and scene.can(place, "RTDB-Update"):
            scene.spread_new(place, 140 + place, b"a", among=place + 1)
            scene.spread_update(place, 140 + place, b"b", among=place + 1)


@network_test(
    "IT_NET_MIXED",
    "Stations of two versions share a bus: each version works as if it were alone",
    requirements="BP-RX-01 BP-RX-02 BP-RX-16 VD-ROB-01",
    shapes=(BUS_4,),
    wire="different",
)
def mixed_versions(scene: Scene) -> None:
    scene.start()
    for role, variable in (("A", 150), ("B", 151)):
        producer, *others = scene.role(role)
        scene.spread_new(producer, variable, b"a", places=[producer, *others])
    for value in (b"b", b"c"):
        for role, variable in (("A", 150), ("B", 151)):
            producer, *others = scene.role(role)
            scene.spread_update(producer, variable, value, places=[producer, *others], among=2)
    scene.wait(2.0)
    for role, variable in (("A", 150), ("B", 151)):
        scene.expect_spread(scene.role(role)[0], variable, places=scene.role(role), among=2, what=f"{variable}, later")


@network_test(
    "IT_NET_BABBLER",
    "A station that sends 500 beacons per second, with many summaries, harms no other station",
    requirements="BP-RX-16 VD-ROB-01",
    shapes=(PAIR, LINE_3, BUS_4),
    longest_s=60.0,
)
def interfering_station(scene: Scene) -> None:
    scene.require_summaries()
    scene.start()
    scene.spread_new(0, 160, b"a")
    builders = [FrameBuilder(codec) for codec in {p.codec.profile.name: p.codec for p in scene.world.places}.values()]
    width = builders[0].codec.profile.types.node_id
    sender = bytes.fromhex("0200000000aa") if width.width == 6 else (0xAA).to_bytes(width.width, "big")
    sender = sender.hex(":").encode() if width.length is not None else sender
    scene.strangers.add(sender)
    for number in range(1500):
        builder = builders[number % len(builders)]
        summaries = [VarSumm((number * 7 + each) % 40 + 200, number & 0xFF) for each in range(10)]
        scene.world.transmit(builder.beacon(sender, number, [builder.vardis(*summaries)]))
        scene.wait(0.002)
        if number in (500, 1000):
            scene.spread_update(0, 160, bytes([0x61 + number // 500]), among=60, patience=30.0)
    scene.wait(1.0)
    scene.spread_update(0, 160, b"z", among=60, what="variable 160 after the babbling", patience=300.0)


@network_test(
    "IT_NET_MALFORMED",
    "A station that sends damaged beacons harms no other: all stations live, and variables are still disseminated",
    requirements="BP-RX-16 BP-RX-09 VD-ROB-01",
    shapes=(PAIR, LINE_3, BUS_4),
    rules=False,
    short=True,
)
def malformed(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 170, b"a")
    frames = [each.octets for each in scene.world.sent()[-20:]]
    damaged = scene.damaged(frames)
    for _ in range(150):
        scene.world.transmit(next(damaged))
        scene.wait(0.02)
    scene.wait(0.5)
    scene.create(0, 178, b"n", repetitions=1)
    # Stations may take few payloads a second: they work off what they have received.
    scene.expect_spread(0, 178, among=60, what="variable 178 after the damaged beacons", patience=30.0)
