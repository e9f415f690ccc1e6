"""The walk "specification 2.1": what a new version of the specification takes, done for real.

The made-up version 2.1 gives VarSpec a `priority` of one octet after `timeout` and VarUpdate a `ttl` of one octet, and
adds container type 7, SET-PRIORITY, with records of varId, priority and seqno. :func:`patched` makes these changes in
a copy of `dcp_spec` and `dcp_stack`; the rest is what is tried. It runs in a process of its own, because the version
must exist before other modules are imported: ``walk_2_1.py PART FOLDER``.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

PROFILE = """\
# Specification 2.1 (made up): variables have a priority that their producer can change, and updates a time to live.
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
records.VarUpdate = ["varId", "seqno", { name = "ttl", extra = { width = 1 }, unit = "s" }, "value"]

[[vardis.own_containers]]
name = "SET-PRIORITY"
number = 7
record = ["varId", { name = "priority", extra = { width = 1 } }, "seqno"]
"""
#: The new files, and the replacements in existing ones. A node sends its own updates with a ttl of 200.
ADDED = {
    "dcp_spec/profiles/dcp-2.1.toml": PROFILE,
    "dcp_stack/vardis/set_priority.py": Path(__file__).with_name("set_priority.py").read_text(encoding="utf-8"),
}
CHANGED = {
    "dcp_spec/constants.py": {'    V2_0 = "2.0"\n': '    V2_0 = "2.0"\n    V2_1 = "2.1"\n'},
    "dcp_stack/own_fields.py": {"Rule]] = MappingProxyType({})": 'Rule]] = {"VarUpdate.ttl": lambda _record: 200}'},
    "dcp_stack/vardis/known_instructions.py": {
        "from .instructions import Instruction\n": "from .instructions import Instruction\n"
        "from .set_priority import SetPriority\n",
        "[type[Instruction], ...]] = ()": "[type[Instruction], ...]] = (SetPriority,)",
    },
}


def patched(packages: list[Path], folder: Path) -> None:
    """Copy `dcp_spec` and `dcp_stack` to `folder`, with the changes."""
    for each in packages:
        shutil.copytree(each, folder / each.name)
    for name, text in ADDED.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, replacements in CHANGED.items():
        text = (folder / name).read_text(encoding="utf-8")
        for old, new in replacements.items():
            assert text.count(old) == 1, f"{name}: {old}"
            text = text.replace(old, new)
        (folder / name).write_text(text, encoding="utf-8")


# -- what is tried ----------------------------------------------------------------------------------------------------


def codec(folder: Path) -> dict[str, Any]:
    """Round trip, dissector, JSON and exports."""
    from dcp_codec.codec import Codec
    from dcp_codec.export.jsonschema import beacon_schema
    from dcp_codec.export.lua import wireshark_dissector
    from dcp_codec.jsonform import beacon_from_json, value_json
    from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarCreate, VarSpec, VarUpdate

    made = Codec("dcp-2.1")
    spec = made.types.extended(VarSpec(1, b"\2" * 6, 1, b"speed", 5, 0), (9,))
    update = made.types.extended(VarUpdate(1, 3, b"x"), (4,))
    change = made.types["SetPriority"](1, 9, 3)  # type: ignore[call-arg]
    containers = (Container(5, (VarCreate(spec, update),)), Container(7, (change,)))
    beacon = Beacon(BPHeader(b"\2" * 6, 1, 0x1111), (Payload(2, containers),))
    octets = made.encode(beacon)
    fields = {each.path: each.value for each in made.dissect(octets).root.walk()}
    return {
        "same": made.decode(octets) == beacon,
        "priority": made.decode(octets).payloads[0].content[0].records[0].spec.priority,  # type: ignore[union-attr]
        "fields": {path: value for path, value in fields.items() if path.endswith(("priority", "ttl"))},
        "json": beacon_from_json(made, json.loads(json.dumps(value_json(made, beacon)))) == beacon,
        "lua": all(name in wireshark_dissector(made) for name in ("priority", "SET-PRIORITY")),
        "schema": "priority" in json.dumps(beacon_schema(made)),
    }


def node(_folder: Path) -> dict[str, Any]:
    """Nodes exchange a variable with the fields, and its producer changes them; the third has no handler."""
    import random

    from dcp_codec.codec import Codec
    from dcp_stack.config import NodeConfig
    from dcp_stack.effects import Dropped, SendBeacon
    from dcp_stack.node import Node

    made, step, wall = Codec("dcp-2.1"), 10_000_000, 1_700_000_000_000_000_000
    nodes = [
        Node(
            NodeConfig(node_id=bytes((2, 0, 0, 0, 0, number)), codec=made), rng=random.Random(number), now=0, wall=wall
        )
        for number in range(3)
    ]
    nodes[2].vardis.instructions.clear()
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

    def fields() -> list[list[int]]:
        entries = [each.vardis.entry(1) for each in nodes]
        return [[each.spec.priority, *each.own["VarUpdate"]] for each in entries]

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
    created = fields()
    producer.instructions["SET-PRIORITY"].change(1, 3)
    producer.update_with_fields(1, b"y", {"ttl": 2}, now=now, wall=wall + now)
    run(1)
    for each in nodes:
        each.vardis.check_invariants()
    return {"created": created, "changed": fields(), "dropped": sorted(dropped), "wrong": wrong}


SCENARIO = """
profile = "dcp-2.1"
nodes = 3
duration_s = 10
topology = "line"

[[events]]
at_s = 1
do = "create"
node = 0
variable = 7
text = "one"
repetitions = 3
own_fields = { priority = 5 }

[[events]]
at_s = 2
do = "update"
node = 0
variable = 7
text = "two"
own_fields = { ttl = 3 }
"""


def announce() -> None:
    """Let nodes send container 7 about each variable that they store."""
    from dcp_stack.vardis.core import Core

    changed = Core.changed

    def also(core: Core, event: str, entry: Any) -> None:
        changed(core, event, entry)
        if event != "deleted":
            core.database.queues["SET-PRIORITY"].append(entry.spec.var_id)

    Core.changed = also  # type: ignore[method-assign]


def forget() -> None:
    """Let nodes lose the ttl of received VarUpdates, and forward their own one."""
    from types import SimpleNamespace

    from dcp_stack.vardis.receive import Receiver

    begin = Receiver.__init__

    def losing(receiver: Receiver, *arguments: Any) -> None:
        begin(receiver, *arguments)
        receiver._own_fields = SimpleNamespace(keep=lambda *_: None)  # type: ignore[assignment]

    Receiver.__init__ = losing  # type: ignore[method-assign]


def _played(folder: Path) -> Any:
    """Play the scenario, and record it in ``folder``."""
    from dcp_lab.sim.scenario.loading import load_scenario
    from dcp_lab.sim.virtual.player import Simulation

    path = folder / "scenario.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    player = Simulation(load_scenario(path), record_medium=folder / "flight.mcap")
    return player, player.run()


def simulator(folder: Path) -> dict[str, Any]:
    """A scenario in which a variable has a priority, and its update a ttl."""
    player, report = _played(folder)
    entries = [each.vardis.entry(7) for each in map(player.network.node, range(3))]
    return {
        "failed": [each.what for each in report.findings if not each.met],
        "fields": [[each.spec.priority, *each.own["VarUpdate"]] for each in entries],
    }


def check(folder: Path) -> dict[str, Any]:
    """A recording of our nodes, and one of nodes that do not keep the ttl."""
    from dcp_codec.capture import open_capture
    from dcp_codec.codec import Codec

    announce()
    right = _judged(folder)
    with open_capture(folder / "flight.mcap") as reader:
        frames = [Codec("dcp-2.1").decode(each.data[14:]) for each in reader]
    kinds = {part.ic_type for each in frames for payload in each.payloads for part in payload.vardis or ()}
    forget()
    return {"right": right, "wrong": _judged(folder), "containers": sorted(kinds)}


def _judged(folder: Path) -> dict[str, str]:
    """Return the rules that are not passed, each with the first finding."""
    from dcp_conformance.check.recording import judge_versions
    from dcp_conformance.definitions.pics import Pics

    _played(folder)
    result, _ = judge_versions(folder / "flight.mcap", "dcp-2.1", Pics())[0]
    return {each.id: f"{each.verdict}: {each.reason}" for each in result.cases if str(each.verdict) == "fail"}


def fuzz(_folder: Path) -> dict[str, Any]:
    """A short campaign against our node, and the values of the field and the container that it sends."""
    import random

    from dcp_lab.fuzz import Campaign, Frame, Limits
    from dcp_lab.fuzz.execute.stack import StackTarget
    from dcp_lab.fuzz.findings.artefact import SavedTarget
    from dcp_lab.fuzz.generate.sequences import Sequences
    from dcp_lab.testing.mutation import Mutator, drawn_pool

    from dcp_codec.codec import Codec

    announce()
    target, rng = StackTarget(Codec("dcp-2.1")), random.Random(1)
    mutator = Mutator(target.codec, rng, drawn_pool(target.codec, rng, 80))
    sequences = Sequences(target.codec, rng, target.own_id, mutator)
    drawn = [step.octets for _ in range(100) for step in sequences.draw() if isinstance(step, Frame)]
    parts = [part for each in drawn for part in _containers(target.codec, each)]
    state = Campaign(target.codec, target, sequences, SavedTarget("stack", target.name), 1, mutator=mutator).run(
        Limits(cases=200)
    )
    return {
        "findings": list(state.findings),
        "cases": state.cases,
        "ttl": len({each.ttl for part in parts if part.ic_type == 2 for each in part.records}),
        "sent": any(part.ic_type == 7 for part in parts),
    }


def _containers(made: Any, octets: bytes) -> list[Any]:
    """Return the containers of a beacon; none if it cannot be decoded."""
    from dcp_codec.errors import DecodeError

    try:
        return [part for payload in made.decode(octets).payloads for part in payload.vardis or ()]
    except DecodeError:
        return []


#: Cases that forward each kind of record, read what the node made itself, compare it with the model, or check all
#: containers.
CASES = (
    "TC_NET_HOP_BV_01-2",
    "TC_NET_JOIN_BV_02",
    "TC_NET_JOIN_BV_03",
    "TC_NET_JOIN_BV_05-update",
    "TC_NET_JOIN_BV_07",
    "TC_DCP_MODEL_BV_01-own-variable-01",
    "TC_VD_PAY_BV_01",
    "TC_VD_TYP_BV_01",
)


def cases(_folder: Path) -> dict[str, Any]:
    """A few cases against our node, and against one that does not keep the fields."""
    from dcp_conformance.definitions.case import all_cases

    from dcp_codec.codec import Codec

    made = Codec("dcp-2.1")
    selection = [all_cases()[name] for name in CASES]
    announce()
    found: dict[str, Any] = {"right": _verdicts(made, selection)}
    forget()
    return found | {"wrong": _verdicts(made, selection)}


def _verdicts(made: Any, selection: Any) -> dict[str, str]:
    """Return ``verdict: reason`` of each case against our node."""
    from dcp_conformance.definitions.pics import Pics
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.reference.inprocess import InProcess, reference_config
    from dcp_conformance.test_system.bench import Session

    sut = InProcess(reference_config(made))
    runner = Runner(Session(made, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    results = [runner.run(each) for each in selection]
    runner.finish()
    return {each.id: f"{each.verdict}: {each.reason}" for each in results}


def suite(_folder: Path) -> dict[str, Any]:
    """Every case against our node: what does not pass, and what only the version excludes."""
    from dcp_conformance.definitions.case import all_cases
    from dcp_selftest.runner import cases

    from dcp_codec.codec import Codec

    announce()
    results = _verdicts(Codec("dcp-2.1"), [each for each in cases() if not each.long])
    return {
        "passed": sum(each.startswith("pass:") for each in results.values()),
        "not fine": [f"{name}: {each}" for name, each in results.items() if each.startswith(_BAD)],
        "excluded": [name for name, each in results.items() if "2.1" in each and "until" in each],
        "excluded in 2.0": [each.id for each in all_cases().values() if each.needs.until is not None and not each.long],
    }


_BAD = ("fail", "inconclusive", "error")


PARTS = {each.__name__: each for each in (codec, node, simulator, check, fuzz, cases, suite)}

if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]](Path(sys.argv[2]))))
