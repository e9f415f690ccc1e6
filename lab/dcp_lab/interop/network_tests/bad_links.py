"""Links that lose, repeat, reorder and delay frames, and networks that fall apart and come together again."""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_codec.impairment import Impairment
from dcp_lab.interop.definition import BUS_4, LINE_3, LINE_5, PAIR, network_test
from dcp_lab.interop.scene import MS, Scene


@network_test(
    "IT_VD_LOSS",
    "With {variant} loss, creations and updates reach every station within the time that this loss explains",
    requirements="VD-PS-01 VD-PS-04 VD-RU-04 VD-RC-03 VD-CMP-11 VD-CMP-12",
    shapes=(PAIR, LINE_3, LINE_5),
    variants={
        "10": Impairment(loss=0.1),
        "30": Impairment(loss=0.3),
        "50": Impairment(loss=0.5),
        "burst": Impairment(loss=0.3, burst=5),
    },
    longest_s={"10": 20.0, "30": 45.0, "50": 120.0, "burst": 45.0},
    talking=False,
)
def loss(scene: Scene, impairment: Impairment) -> None:
    scene.require_summaries()
    scene.set_quality(impairment)
    scene.start()
    for variable in range(4):
        scene.create(0, 80 + variable, b"0")
    scene.expect_spread(0, *range(80, 84))
    for round_ in range(5):
        for variable in range(4):
            scene.update(0, 80 + variable, bytes([0x61 + round_]))
        scene.wait(0.15)
    scene.expect_spread(0, *range(80, 84), what="4 variables after 5 rounds of updates")
    for round_ in range(3):
        scene.spread_update(0, 80, bytes([0x41 + round_]), among=4)


@network_test(
    "IT_VD_DISORDER",
    "Frames that arrive twice, late and in another order leave every station with the newest values",
    requirements="VD-PU-05 VD-PU-06 VD-PS-03",
    shapes=(PAIR, LINE_3, BUS_4),
)
def disorder(scene: Scene) -> None:
    scene.require_summaries()
    scene.set_quality(Impairment(duplicate=0.2, reorder=0.2, delay=5 * MS, jitter=60 * MS, reorder_delay=250 * MS))
    scene.start()
    scene.spread_new(0, 90, b"0")
    for value in range(20):
        scene.update(0, 90, bytes([0x61 + value]))
        scene.wait(0.1)
    scene.expect_spread(0, 90, what="variable 90 after 20 updates")
    scene.wait(1.0)
    scene.expect_spread(0, 90, what="variable 90, later")


@network_test(
    "IT_VD_OUTAGE",
    "Links that are down two thirds of the time do not keep a variable from reaching every station",
    requirements="VD-PS-01 VD-PS-04",
    shapes=(PAIR, LINE_3),
    talking=False,
)
def outages(scene: Scene) -> None:
    scene.require_summaries()
    scene.set_outages()
    scene.start()
    scene.spread_new(0, 95, b"0")
    scene.spread_update(0, 95, b"1")


@network_test(
    "IT_VD_PARTITION",
    "Changes on both sides of a partition reach the other side after the partition has ended, and not before",
    requirements="VD-PS-01 VD-PS-04 VD-RU-04 VD-RC-03",
    shapes=(PAIR, BUS_4, LINE_5),
    short=True,
)
def partition(scene: Scene) -> None:
    scene.require_summaries()
    middle = len(scene.places) // 2
    left, right = scene.places[:middle], scene.places[middle:]
    scene.start()
    other = right[-1] if scene.can(right[-1], "RTDB-Create") and scene.can(right[-1], "RTDB-Update") else None
    scene.spread_new(0, 100, b"a")
    if other is not None:
        scene.spread_new(other, 101, b"a")
    scene.partition(left, right)
    scene.update(0, 100, b"b")
    scene.create(0, 102, b"n")
    scene.expect_spread(0, 100, 102, places=left, among=3)
    if other is not None:
        scene.spread_update(other, 101, b"c", places=right, among=3)
    crossed = [place for place in right if scene.number(place, 100) not in (None, 0)]
    scene.expect(not crossed, "nothing crosses a partition", f"places {crossed} have the update")
    scene.wait(2.0)
    scene.partition()
    scene.expect_spread(0, 100, 102, among=3, what="variables 100 and 102 after the partition")
    if other is not None:
        scene.expect_spread(other, 101, among=3, what="variable 101 after the partition")
    scene.spread_update(0, 102, b"z", among=3)


@network_test(
    "IT_VD_PARTITIONEDCREATE",
    "A variable that is created again during a partition replaces the old one on the other side",
    requirements="VD-PC-01 VD-PC-02",
    shapes=(PAIR, LINE_5),
    since=SpecVersion.V2_0,
)
def partitioned_creation(scene: Scene) -> None:
    middle = len(scene.places) // 2
    left, right = scene.places[:middle], scene.places[middle:]
    scene.start()
    scene.spread_new(0, 105, b"a")
    scene.partition(left, right)
    scene.delete(0, 105)
    scene.expect_deleted(105, places=left)
    scene.wait(1.0)
    scene.partition()
    scene.wait(2.0)
    alive = [place for place in left if scene.is_alive(place, 105)]
    scene.expect(
        not alive, "a variable stays deleted although stations that missed the deletion summarise it",
        f"it is back at places {alive}", "VD-PS-02", "VD-DEL-06",
    )  # fmt: skip
    # A deletion is repeated a few times and then no longer; a new creation is what brings the sides together.
    scene.spread_new(0, 105, b"n", what="variable 105, created again after the partition")


@network_test(
    "IT_VD_ONEWAY",
    "A station that hears its neighbour without being heard learns its variables from updates, and harms no station",
    requirements="VD-PU-07 VD-ROB-01",
    shapes=(PAIR,),
)
def one_way(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 107, b"a")
    scene.set_quality(Impairment(loss=1.0), 1, 0)
    scene.loss = 0.0
    for value in (b"b", b"c", b"d"):
        scene.spread_update(0, 107, value)
    scene.set_quality(Impairment(), 1, 0)
    scene.spread_update(0, 107, b"e")


@network_test(
    "IT_VD_PRODUCERGONE",
    "A relay that has the newest value forwards it after its producer has left",
    requirements="VD-RU-04 VD-RC-03 VD-PS-01 VD-PS-04",
    shapes=(LINE_3, LINE_5),
)
def producer_gone(scene: Scene) -> None:
    scene.require_summaries()
    scene.start()
    scene.spread_new(0, 200, b"a")
    near, far = scene.places[:2], scene.places[2:]
    scene.partition(near, far)
    scene.update(0, 200, b"b")
    scene.create(0, 201, b"n")
    scene.expect_spread(0, 200, 201, places=near)
    # By now the relay has nothing left to repeat.
    scene.wait(2.0)
    scene.switch(0, on=False)
    scene.partition()
    scene.expect_spread(0, 200, 201, places=scene.places[1:], what="2 variables whose producer is gone")


@network_test(
    "IT_VD_FARBEHIND",
    "A station that missed {variant} updates around the wrap catches up after a partition",
    requirements="VD-RU-03 VD-PS-04 VD-PU-06 VD-TYP-03",
    shapes=(PAIR, LINE_3),
    variants={"10": 10, "100": 100},
)
def many_missed_updates(scene: Scene, missed: int) -> None:
    scene.require_summaries()
    scene.start()
    scene.spread_new(0, 205, b"0")
    for _ in range(5):
        for _ in range(50):
            scene.update(0, 205, scene.rng.randbytes(1))
        scene.expect_spread(0, 205)
    scene.partition([0], scene.places[1:])
    for _ in range(missed):
        scene.update(0, 205, scene.rng.randbytes(1))
    scene.wait(2.0)
    scene.partition()
    scene.expect_spread(0, 205, what=f"variable 205 after {missed} missed updates")
    scene.wait(1.0)
    scene.expect_spread(0, 205, what="variable 205, later")
