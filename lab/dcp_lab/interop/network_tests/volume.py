"""Many variables, large values, many updates, and soft state of variables."""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_lab.interop.definition import GRID_8, LINE_3, LINE_5, PAIR, network_test
from dcp_lab.interop.scene import Scene


@network_test(
    "IT_VD_MANY",
    "255 variables of one station reach every station, and all are updated",
    requirements="VD-CMP-03 VD-CMP-13 VD-PS-01 VD-PC-09",
    shapes=(PAIR, LINE_3),
    longest_s=80.0,
)
def many_variables(scene: Scene) -> None:
    scene.require(scene.limits.variables >= 255, "a station has no room for 255 variables")
    scene.require_summaries()
    scene.start()
    # Applications of permitted variants have 250.
    chosen = [variable for variable in range(255) if variable != 250]
    for variable in chosen:
        scene.create(0, variable, bytes([variable or 1]))
    scene.expect_spread(0, *chosen, what="254 variables")
    for variable in chosen:
        scene.update(0, variable, bytes([255 - variable]))
    scene.expect_spread(0, *chosen, what="254 variables after an update of each")


@network_test(
    "IT_VD_LONGEST",
    "Values of the greatest length reach every station, alone and several at a time",
    requirements="VD-TYP-02 VD-PAY-02 VD-CMP-13",
    shapes=(PAIR, LINE_3, LINE_5),
)
def longest_values(scene: Scene) -> None:
    scene.start()
    length = scene.limits.value
    for variable in range(8):
        value = scene.rng.randbytes(length)
        # The size of a record must leave room for its container in the smallest payload.
        scene.require(length + 40 <= scene.limits.payload, "a value of the greatest length does not fit into a payload")
        scene.create(0, 110 + variable, value)
    scene.expect_spread(0, *range(110, 118))
    for variable in range(8):
        scene.update(0, 110 + variable, scene.rng.randbytes(length))
    scene.expect_spread(0, *range(110, 118), what="8 long values after an update of each")


@network_test(
    "IT_VD_WRAP",
    "Sequence numbers wrap around at a relay: every update after the wrap is newer",
    requirements="VD-TYP-03 VD-UPD-07 VD-PU-06 VD-PU-07 VD-PS-04",
    shapes=(LINE_3, GRID_8),
)
def wrap(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 120, b"0")
    # Steps of less than half the number space, so that every station sees each step as newer.
    for step in range(5):
        for _ in range(50):
            scene.update(0, 120, scene.rng.randbytes(1))
        scene.expect_spread(0, 120, what=f"variable 120 after {50 * (step + 1)} updates")
    for _ in range(12):
        scene.spread_update(0, 120, scene.rng.randbytes(1), what="variable 120 around the wrap")


@network_test(
    "IT_VD_TIMEOUT",
    "Variables with a timeout disappear everywhere when their producer is gone, and stay while it updates them",
    requirements="VD-SCR-03 VD-SCR-05 VD-SCR-06",
    shapes=(PAIR, LINE_3, LINE_5),
    since=SpecVersion.V2_0,
    longest_s=20.0,
    talking=False,
)
def timeouts(scene: Scene) -> None:
    scene.start()
    timeout = 3.0
    scene.create(0, 125, b"a", timeout=round(timeout * 1000))
    scene.create(0, 126, b"b")
    scene.expect_spread(0, 125, 126)
    for value in range(6):
        scene.wait(1.0)
        scene.update(0, 125, bytes([0x61 + value]))
    scene.expect_spread(0, 125, what="variable 125, updated beyond its timeout")
    scene.create(0, 127, b"c", timeout=round(timeout * 1000))
    scene.expect_spread(0, 127, among=3)
    scene.wait(timeout + 2 * scene.limits.scrubbing_period_ms / 1000)
    scene.expect_deleted(127)
    scene.update(0, 126, b"d")
    scene.create(0, 125, b"e", timeout=round(timeout * 1000))
    scene.expect_spread(0, 125, 126, among=3)
    scene.switch(0, on=False)
    others = [place for place in scene.places if place != 0]
    scene.wait(timeout + 2 * scene.limits.scrubbing_period_ms / 1000)
    scene.expect_deleted(125, places=others)
    scene.expect_spread(0, 126, places=others, what="variable 126, which has no timeout")


@network_test(
    "IT_VD_TWOPRODUCERS",
    "Two stations that create one variable during a partition harm no other variable and no station",
    requirements="VD-ROB-01 VD-PC-03",
    shapes=(PAIR, LINE_3),
)
def two_producers(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 130, b"a")
    scene.partition([0], scene.places[1:])
    scene.create(0, 131, b"x")
    scene.wait(0.2)
    scene.world.call(1, "RTDB-Create", {"varId": 131, "repCnt": 1, "descr": "v", "value": "79"})
    scene.note(1, "RTDB-Create 131 = 79, during the partition")
    scene.wait(1.0)
    scene.partition()
    scene.wait(3.0)
    scene.spread_update(0, 130, b"b", among=2, what="variable 130, which has one producer")
    scene.spread_new(1, 132, b"n", among=3)
    alive = [place for place in scene.places if scene.is_alive(place, 131)]
    scene.expect(alive == scene.places, "every station keeps the disputed variable", f"only places {alive} have it")
