"""The walk "specification 2.1": what a new version of the specification takes, done for real.

The made-up version 2.1 gives VarSpec a `priority` of one octet after `timeout`, and adds container type 7,
SET-PRIORITY, with records of varId, priority and seqno. :func:`patched` makes a copy of `dcp_spec` with the two changes
of the wire layer. The class :func:`set_priority` is the change of the node; the rest is what is tried. It runs in a
process of its own, because the version must exist before other modules are imported: ``walk_2_1.py PART FOLDER``.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

PROFILE = """\
# Specification 2.1 (made up): variables have a priority that their producer can change.
extends = "dcp-2.0"
name = "dcp-2.1"
title = "DCP specification 2.1"
spec_version = "2.1"

[vardis]
var_spec = [
    "varId", "prodId", "repCnt", "creationTime", "timeout",
    { name = "priority", extra = { width = 1 }, note = "how urgent the variable is" },
    "descr",
]

[[vardis.own_containers]]
name = "SET-PRIORITY"
number = 7
record = ["varId", { name = "priority", extra = { width = 1 } }, "seqno"]
"""
VERSION = ('    V2_0 = "2.0"\n', '    V2_0 = "2.0"\n    V2_1 = "2.1"\n')


def patched(source: Path, folder: Path) -> None:
    """Copy the package `dcp_spec` to `folder`, with a line more for the version, and its profile."""
    copy = folder / "dcp_spec"
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
    constants = copy / "constants.py"
    before = constants.read_text(encoding="utf-8")
    assert before.count(VERSION[0]) == 1
    constants.write_text(before.replace(*VERSION), encoding="utf-8")
    (copy / "profiles" / "dcp-2.1.toml").write_text(PROFILE, encoding="utf-8")


# -- the change of the node -------------------------------------------------------------------------------------------


def set_priority() -> Any:
    """The class that a node needs for the container; imported late, see the docstring of the module."""
    from dcp_stack.vardis.instructions import Instruction

    class SetPriority(Instruction):
        """SET-PRIORITY: the producer changes the priority of a variable; receivers pass the change on once."""

        container = "SET-PRIORITY"

        def receive(self, record: Any, now: int, wall: int) -> str | None:
            entry = self.entry(record.var_id)
            if entry is None or entry.spec.prod_id == self.core.own_id:
                return "update-unknown" if entry is None else "update-own"
            if record.priority != self.own_field(entry, "priority"):
                self.change(record.var_id, record.priority)
            return None

        def change(self, var_id: int, priority: int) -> None:
            """Note the new priority and send it."""
            entry = self.entry(var_id)
            assert entry is not None
            self.change_spec(entry, priority=priority)
            self.queue.append(var_id)

        def record(self, var_id: int) -> Any:
            entry = self.entry(var_id)
            assert entry is not None
            return self.record_type(var_id=var_id, priority=self.own_field(entry, "priority"), seqno=entry.seqno)

    return SetPriority


# -- what is tried ----------------------------------------------------------------------------------------------------


def codec(folder: Path) -> dict[str, Any]:
    """Round trip, dissector, JSON and exports."""
    from dcp_codec.codec import Codec
    from dcp_codec.export.jsonschema import beacon_schema
    from dcp_codec.export.lua import wireshark_dissector
    from dcp_codec.jsonform import beacon_from_json, value_json
    from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarCreate, VarUpdate

    made = Codec("dcp-2.1")
    spec = made.var_spec_type(1, b"\2" * 6, 1, b"speed", 5, 0, extra=(9,))  # type: ignore[call-arg]
    change = made.types["SetPriority"](1, 9, 3)  # type: ignore[call-arg]
    containers = (Container(5, (VarCreate(spec, VarUpdate(1, 3, b"x")),)), Container(7, (change,)))
    beacon = Beacon(BPHeader(b"\2" * 6, 1, 0x1111), (Payload(2, containers),))
    octets = made.encode(beacon)
    fields = {each.path: each.value for each in made.dissect(octets).root.walk()}
    return {
        "same": made.decode(octets) == beacon,
        "priority": made.decode(octets).payloads[0].content[0].records[0].spec.priority,  # type: ignore[union-attr]
        "fields": {path: value for path, value in fields.items() if path.endswith("priority")},
        "json": beacon_from_json(made, json.loads(json.dumps(value_json(made, beacon)))) == beacon,
        "lua": all(name in wireshark_dissector(made) for name in ("priority", "SET-PRIORITY")),
        "schema": "priority" in json.dumps(beacon_schema(made)),
    }


def node(_folder: Path) -> dict[str, Any]:
    """Two nodes exchange a variable with a priority, and its producer changes the priority; a third has no handler."""
    import random

    from dcp_codec.codec import Codec
    from dcp_stack.config import NodeConfig
    from dcp_stack.effects import Dropped, SendBeacon
    from dcp_stack.node import Node

    made, step, wall = Codec("dcp-2.1"), 10_000_000, 1_700_000_000_000_000_000
    handlers = ((set_priority(),), (set_priority(),), ())
    nodes = [
        Node(
            NodeConfig(node_id=bytes((2, 0, 0, 0, 0, number)), codec=made, instructions=handled),
            rng=random.Random(number),
            now=0,
            wall=wall,
        )
        for number, handled in enumerate(handlers)
    ]
    dropped: set[str] = set()
    now = 0

    def run(seconds: float) -> None:
        nonlocal now
        end = now + int(seconds * 1e9)
        while now < end:
            now += step
            for sender in nodes:
                sender.handle_timeout(now, wall + now)
            for sender in nodes:
                for effect in sender.take_effects():
                    if isinstance(effect, SendBeacon):
                        for receiver in nodes:
                            if receiver is not sender:
                                receiver.handle_frame(effect.octets, now=now, wall=wall + now)
                    elif isinstance(effect, Dropped):
                        dropped.add(effect.reason)

    def priorities() -> list[int | None]:
        entries = [each.vardis.entry(1) for each in nodes]
        return [None if each is None else each.spec.priority for each in entries]

    for each in nodes:
        each.start(0, wall)
    run(0.5)
    producer = nodes[0].vardis
    wrong = ""
    try:
        producer.create(1, None, 2, b"speed", b"x", own_fields={"priority": 256}, now=now, wall=wall + now)
    except ValueError as error:
        wrong = str(error)
    producer.create(1, None, 2, b"speed", b"x", own_fields={"priority": 9}, now=now, wall=wall + now)
    run(1)
    created = priorities()
    producer.instructions["SET-PRIORITY"].change(1, 3)
    run(1)
    for each in nodes:
        each.vardis.check_invariants()
    return {"created": created, "changed": priorities(), "dropped": sorted(dropped), "wrong": wrong}


def simulator(folder: Path) -> dict[str, Any]:
    """A scenario in which a variable has a priority."""
    from dcp_stack.sim.scenario.loading import load_scenario
    from dcp_stack.sim.virtual.player import Simulation

    path = folder / "scenario.toml"
    path.write_text(
        """
profile = "dcp-2.1"
nodes = 3
duration_s = 4
topology = "line"

[[events]]
at_s = 1
do = "create"
node = 0
variable = 7
text = "one"
own_fields = { priority = 5 }
""",
        encoding="utf-8",
    )
    player = Simulation(load_scenario(path))
    report = player.run()
    entries = [each.vardis.entry(7) for each in map(player.network.node, range(3))]
    return {
        "failed": [each.what for each in report.findings if not each.met],
        "priorities": [None if each is None else each.spec.priority for each in entries],
    }


def suite(_folder: Path) -> dict[str, Any]:
    """Every case against our node with the handler: what does not pass, and what only the version excludes."""
    import msgspec
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.model.case import all_cases
    from dcp_conformance.model.pics import Pics
    from dcp_conformance.reference.inprocess import InProcess, reference_config
    from dcp_conformance.test_system.bench import Session
    from dcp_selftest.runner import cases

    from dcp_codec.codec import Codec

    made = Codec("dcp-2.1")
    config = msgspec.structs.replace(reference_config(made), instructions=(set_priority(),))
    sut = InProcess(config)
    runner = Runner(Session(made, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    results = [runner.run(each) for each in cases() if not each.long]
    runner.finish()
    verdicts: dict[str, int] = {}
    for each in results:
        verdicts[str(each.verdict)] = verdicts.get(str(each.verdict), 0) + 1
    return {
        "verdicts": verdicts,
        "not fine": [f"{each.id}: {each.verdict}: {each.reason}" for each in results if str(each.verdict) in _BAD],
        "excluded": [each.id for each in results if "2.1" in each.reason and "until" in each.reason],
        "excluded in 2.0": [each.id for each in all_cases().values() if each.needs.until is not None and not each.long],
    }


_BAD = ("fail", "inconclusive", "error")


PARTS = {each.__name__: each for each in (codec, node, simulator, suite)}

if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]](Path(sys.argv[2]))))
