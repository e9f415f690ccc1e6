"""Variables reach all stations: create, update, delete, create again."""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_lab.interop.definition import SPREAD, network_test
from dcp_lab.interop.scene import Scene


@network_test(
    "IT_VD_CREATE",
    "A variable that is created at each station in turn reaches every station with its value",
    requirements="VD-CRE-12 VD-PC-07 VD-PC-09 VD-PC-10",
    shapes=SPREAD,
    short=True,
)
def create(scene: Scene) -> None:
    scene.start()
    for place in scene.places:
        if scene.can(place, "RTDB-Create"):
            scene.spread_new(place, 10 + place, bytes([0x40 + place]))
    # A record that was lost on the way must not be needed: by now summaries have gone round.
    scene.wait(1.0)
    for place in scene.places:
        if scene.can(place, "RTDB-Create"):
            scene.expect_spread(place, 10 + place, among=len(scene.places), what=f"variable {10 + place}, later")


@network_test(
    "IT_VD_UPDATE",
    "Each of several updates reaches every station, and the last of a burst remains",
    requirements="VD-UPD-07 VD-UPD-10 VD-PU-07",
    shapes=SPREAD,
    short=True,
)
def update(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 20, b"0")
    for value in (b"1", b"2", b"3"):
        scene.spread_update(0, 20, value)
    for number in range(10):
        scene.update(0, 20, bytes([0x61 + number]))
        scene.wait(0.01)
    scene.expect_spread(0, 20, what="variable 20 after a burst of updates")
    scene.wait(1.0)
    scene.expect_spread(0, 20, what="variable 20, later")


@network_test(
    "IT_VD_DELETE",
    "A deletion reaches every station, and the variable does not come back",
    requirements="VD-DEL-05 VD-PD-04 VD-PD-02",
    shapes=SPREAD,
    short=True,
    longest_s=40.0,
)
def delete(scene: Scene) -> None:
    scene.start()
    scene.create(0, 30, b"x", repetitions=min(3, scene.limits.repetitions))
    scene.create(0, 31, b"y")
    scene.expect_spread(0, 30, 31)
    scene.delete(0, 30)
    scene.expect_deleted(30)
    scene.wait(2.0)
    alive = [place for place in scene.places if scene.is_alive(place, 30)]
    scene.expect(not alive, "a deleted variable stays deleted", f"it is back at places {alive}", "VD-DEL-05")
    scene.expect_spread(0, 31, what="variable 31, which was not deleted")


@network_test(
    "IT_VD_RECREATE",
    "A variable that is created again after its deletion, or while it lives, replaces the old one at every station",
    requirements="VD-CRE-03 VD-PC-01 VD-PC-02",
    shapes=SPREAD,
    since=SpecVersion.V2_0,
)
def create_again(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 40, b"a")
    scene.spread_update(0, 40, b"b")
    scene.spread_new(0, 40, b"c", what="variable 40, created again while it lives")
    scene.delete(0, 40)
    scene.expect_deleted(40)
    scene.wait(0.5)
    scene.spread_new(0, 40, b"d", what="variable 40, created again after its deletion")
    scene.spread_update(0, 40, b"e")
