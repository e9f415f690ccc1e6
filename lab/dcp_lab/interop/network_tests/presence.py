"""Presence of stations: discovery, soft state of neighbour tables, late arrivals, restarts."""

from __future__ import annotations

from dcp_lab.interop.definition import BUS_4, GRID_8, LINE_3, LINE_5, PAIR, SPREAD, network_test
from dcp_lab.interop.scene import Scene


@network_test(
    "IT_SRP_DISCOVERY",
    "Each station lists exactly the stations that it hears",
    requirements="SRP-RX-03 SRP-RX-06 SRP-NT-03",
    shapes=SPREAD,
    entities=("srp",),
    short=True,
)
def discovery(scene: Scene) -> None:
    scene.start()
    scene.report_states()
    scene.expect_neighbours(3.0)
    scene.wait(2.0)
    scene.expect_neighbours(1.0)


@network_test(
    "IT_SRP_SOFTSTATE",
    "A station that falls silent leaves all neighbour tables after the timeout, and is listed again when it returns",
    requirements="SRP-RX-03 SRP-PAR-01",
    shapes=(PAIR, LINE_3, BUS_4),
    entities=("srp",),
    talking=False,
)
def soft_state(scene: Scene) -> None:
    scene.start()
    scene.report_states()
    scene.expect_neighbours(3.0)
    gone = scene.places[-1]
    scene.switch(gone, on=False)
    # SRP scrubs its table with a period that is left to the implementation; twice the timeout is ample.
    scene.expect_neighbours(2 * scene.limits.neighbour_timeout_ms / 1000 + 2.0, absent=[gone])
    scene.switch(gone, on=True)
    scene.expect_neighbours(3.0)


@network_test(
    "IT_VD_LATE",
    "A station that joins late learns every variable with its present value",
    requirements="VD-PS-01 VD-RC-03 VD-PC-07",
    shapes=SPREAD,
    short=True,
)
def late_join(scene: Scene) -> None:
    scene.require_summaries()
    late = scene.places[-1]
    present = scene.places[:-1]
    scene.start(present)
    for variable in range(5):
        scene.create(0, 50 + variable, b"a")
    reached = sorted(scene.shape.hops(0, present))
    scene.expect_spread(0, *range(50, 55), places=reached)
    scene.update(0, 51, b"b")
    scene.update(0, 52, b"c")
    scene.expect_spread(0, 51, 52, places=reached, among=5)
    scene.wait(3.0)
    scene.switch(late, on=True)
    scene.expect_spread(0, *range(50, 55), what="5 variables at a station that joined late")
    scene.spread_update(0, 50, b"z", among=5)


@network_test(
    "IT_VD_PRODUCERRESTART",
    "After its producer has restarted without memory a variable is unchanged, and a new one reaches all stations",
    requirements="VD-PC-07 VD-CRE-12 VD-ROB-01",
    shapes=SPREAD,
)
def restart_of_producer(scene: Scene) -> None:
    scene.start()
    scene.spread_new(0, 60, b"a")
    scene.spread_update(0, 60, b"b")
    scene.switch(0, on=False)
    scene.wait(1.0)
    others = [place for place in scene.places if place != 0]
    scene.expect_spread(0, 60, places=others, what="variable 60 while its producer is off")
    scene.switch(0, on=True)
    scene.wait(1.0)
    scene.expect_spread(0, 60, places=others, what="variable 60 after the restart of its producer")
    scene.spread_new(0, 61, b"n", among=2)
    scene.spread_update(0, 61, b"o", among=2)


@network_test(
    "IT_VD_RELAYRESTART",
    "A relay that restarts without memory learns the variables again and relays the next update",
    requirements="VD-PS-01 VD-RC-03 VD-PU-07",
    shapes=(LINE_3, LINE_5, GRID_8),
)
def restart_of_relay(scene: Scene) -> None:
    scene.require_summaries()
    scene.start()
    for variable in range(3):
        scene.create(0, 70 + variable, b"a")
    scene.expect_spread(0, 70, 71, 72)
    scene.switch(1, on=False)
    scene.wait(0.5)
    scene.update(0, 70, b"b")
    scene.wait(1.0)
    scene.switch(1, on=True)
    scene.expect_spread(0, 70, 71, 72, what="3 variables after the restart of a relay")
    scene.spread_update(0, 72, b"c", among=3)


@network_test(
    "IT_NET_BOTH",
    "State reports in every beacon and variables share the beacons: neighbours and values are complete",
    requirements="BP-RX-07 SRP-RX-03 VD-PC-07",
    shapes=(PAIR, LINE_3, BUS_4),
    entities=("srp", "vardis"),
)
def reports_and_variables(scene: Scene) -> None:
    scene.start()
    scene.report_states()
    scene.expect_neighbours(3.0)
    scene.spread_new(0, 65, b"a")
    for value in (b"b", b"c", b"d"):
        scene.spread_update(0, 65, value)
    scene.expect_neighbours(1.0)
