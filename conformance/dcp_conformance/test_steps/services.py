"""Requests to the services of VarDis and SRP, and the statuses that a version of the specification defines.

Helpers for several case modules: parameters that only some versions have, statuses with different names, and ways to
create variables and state reports.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from dcp_spec.constants import BP_PROTID_SRP, ICType, SpecVersion

from dcp_codec.values import VarCreate, VarDelete
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.received import ReceivedBeacon, var_id_of
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer
from dcp_conformance.upper_tester import Answer

OK = "VARDIS-STATUS-OK"
INACTIVE = "VARDIS-STATUS-INACTIVE"
EXISTS = "VARDIS-STATUS-VARIABLE-EXISTS"
UNKNOWN = "VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST"
NOT_PRODUCER = "VARDIS-STATUS-NOT-PRODUCER"
DESCRIPTION_TOO_LONG = "VARDIS-STATUS-VARIABLE-DESCRIPTION-TOO-LONG"
VALUE_TOO_LONG = "VARDIS-STATUS-VALUE-TOO-LONG"
ILLEGAL_REPCOUNT = "VARDIS-STATUS-ILLEGAL-REPCOUNT"
#: JSON-RPC error for a value that the profile cannot express.
NOT_EXPRESSIBLE = -32602
#: JSON-RPC error for a request without any response (readings X10 and X30).
NO_RESPONSE = -32002


def deleted_status(bench: Bench) -> str:
    """Return the status of read, update and delete for a variable that is already deleted."""
    if bench.features.removed_after_deletion:
        return "VARDIS-STATUS-VARIABLE-BEING-DELETED"
    return "VARDIS-STATUS-VARIABLE-IS-DELETED"


def or_removed(bench: Bench, status: str) -> tuple[str, ...]:
    """Return the allowed statuses: up to 1.3, a deleted variable may have been removed after its repetitions."""
    return (status, UNKNOWN) if bench.features.removed_after_deletion else (status,)


def statuses_after_deletion(bench: Bench) -> tuple[str, ...]:
    """As :func:`deleted_status`, with :func:`or_removed`."""
    return or_removed(bench, deleted_status(bench))


def too_long(bench: Bench) -> bytes:
    """Return a value that is one octet longer than the implementation allows."""
    return b"v" * (bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH") + 1)


def empty_status(bench: Bench) -> str:
    """Return the status of create and update for an empty value."""
    return "VARDIS-STATUS-" + ("INVALID" if bench.profile.spec_version < SpecVersion.V1_1 else "EMPTY") + "-VALUE"


def expect_any(bench: Bench, statuses: Collection[str], method: str, /, *requirements: str, **params: Any) -> Answer:
    """As :meth:`.Services.expect_status`, with several allowed statuses."""
    answer = bench.call(method, **params)
    bench.services.check_status(answer, statuses, method, *requirements)
    return answer


def rows(answer: Answer, member: str) -> list[dict[str, Any]]:
    """Return a member of a result that is a list of objects; empty if it is missing.

    Raises ``UpperTesterError`` for any other value, which violates the contract of the upper tester and is not a fault
    of the implementation.
    """
    found = answer.result.get(member, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise UpperTesterError(f"{member} must be a list of objects: {str(found)[:200]}")
    return found


def described(answer: Answer) -> dict[str, Any]:
    """Return the entry in a result of RTDB-DescribeVariable; empty if it is missing. Raises as :func:`rows`."""
    found = answer.result.get("variable", {})
    if not isinstance(found, dict):
        raise UpperTesterError(f"variable must be an object: {str(found)[:200]}")
    return found


# -- time --------------------------------------------------------------------------------------------------------------


class Moment(NamedTuple):
    """Interval in which a request was executed: two times of the tester's clock, ns since 1970."""

    before: int
    after: int


def timed(bench: Bench, method: str, /, **params: Any) -> Moment:
    """Call a service like :meth:`.Services.must`, and return when it was executed."""
    before = bench.lower.wall()
    bench.must(method, **params)
    return Moment(before, bench.lower.wall())


# -- VarDis ------------------------------------------------------------------------------------------------------------


def create_request(
    bench: Bench,
    var_id: int,
    *,
    rep_cnt: int = 1,
    descr: str = "tester",
    value: bytes = b"value",
    timeout: int = 0,
    exact: bool = False,
) -> dict[str, Any]:
    """Return parameters of RTDB-Create. Up to 1.1 the application sets the producer (VD-CRE-08).

    Value and description are truncated to the implementation's maximum lengths unless ``exact``. Stops the case as not
    applicable if the profile cannot express ``timeout`` (in ms).
    """
    bench.records.require_timeout(timeout)
    if not exact:
        value, descr = bench.records.value(value), bench.records.descr(descr.encode()).decode(errors="ignore")
    request: dict[str, Any] = {"varId": var_id, "repCnt": rep_cnt, "descr": descr, "value": value.hex()}
    if timeout:
        request["timeout"] = timeout
    if not bench.features.producer_set_by_vardis:
        request["prodId"] = bench.identifiers.sut_id.hex(":")
    return request


def longest_description(bench: Bench) -> int:
    """Return the maximum length of a description in octets; the parameter of 1.0 includes a NUL (VD-CRE-04)."""
    name = "VARDISPAR_MAX_DESCRIPTION_LENGTH"
    stated = name in bench.session.parameters or bench.sut.pixit.max_description_length is not None
    return bench.sut.bound(name) - (1 if stated and bench.features.string_format == "nul-terminated" else 0)


def produced(bench: Bench, **request: Any) -> int:
    """Create one of the node's own variables and return its identifier; inconclusive if that fails."""
    var_id = bench.identifiers.own_var_id()
    bench.must("RTDB-Create", **create_request(bench, var_id, **request))
    return var_id


def created_again(bench: Bench, var_id: int, **request: Any) -> None:
    """Create an existing variable of the node's own again; not applicable if the node rejects that (X20)."""
    params = create_request(bench, var_id, **request)
    answer = bench.call("RTDB-Create", **params)
    if answer.is_status(EXISTS):
        bench.reading("X20", "by-description")
        bench.verdicts.not_applicable("RTDB-Create rejects the identifier of an existing variable (X20)")
    bench.services.require_asked(answer, "RTDB-Create succeeds, which this case needs")
    bench.needed(answer.ok, "RTDB-Create succeeds, which this case needs", str(answer))


def settled(bench: Bench, var_id: int, since: int | None = None) -> None:
    """Wait for the last repetition of a variable's VarCreate.

    ``since``: a mark before the creation, if beacons were received after it. Without it, only VarCreates
    that are received from now on count, and if none follows, the wait lasts 60 beacon periods.
    """
    bench.until_quiet(lambda heard: heard.instructions(ICType.CREATE_VARIABLES, var_id), since=since)


def teach_variable(bench: Bench, peer: Peer, **record: Any) -> int:
    """Teach the implementation a new variable of a peer and return its identifier; inconclusive if that fails."""
    var_id = bench.var_id()
    _send_until_forwarded(bench, peer, peer.create(var_id, **record), ICType.CREATE_VARIABLES, "a forwarded VarCreate")
    return var_id


def deleted_by_peer(bench: Bench, rep_cnt: int) -> int:
    """Let a peer create a variable and delete it; inconclusive if the implementation does not forward both."""
    peer = bench.peer()
    var_id = teach_variable(bench, peer, rep_cnt=rep_cnt)
    _send_until_forwarded(bench, peer, peer.delete(var_id), ICType.DELETE_VARIABLES, "a forwarded VarDelete")
    return var_id


def _send_until_forwarded(bench: Bench, peer: Peer, record: VarCreate | VarDelete, kind: ICType, what: str) -> None:
    """Send a record up to three times until the implementation forwards it: frames may be lost."""
    for _ in range(3):
        peer.send(record)
        if bench.until_instruction(kind, var_id_of(record)) is not None:
            return
    bench.inconclusive(f"{what}, which this case needs", "none in time")


def entry_of(bench: Bench, var_id: int) -> dict[str, Any] | None:
    """Return the database entry from RTDB-DescribeVariable; None if the request is rejected."""
    answer = bench.call("RTDB-DescribeVariable", varId=var_id)
    return (described(answer) or None) if answer.ok else None


def listed(bench: Bench) -> dict[int, dict[str, Any]]:
    """Return the variables in RTDB-DescribeDatabase by identifier."""
    return {each["varId"]: each for each in rows(bench.must("RTDB-DescribeDatabase"), "variables") if "varId" in each}


def registration(bench: Bench, prot_id: int, name: str, *requirements: str) -> dict[str, Any]:
    """Return the entry of a protocol in BP-ListRegisteredProtocols; fails and stops the case if there is none."""
    found = rows(bench.must("BP-ListRegisteredProtocols"), "protocols")
    shown = next((row for row in found if row.get("protocolId") == prot_id), None)
    if shown is None and _may_be_missing(bench, name):
        entity = name.lower()
        observed = (
            f"not registered, and none of its services is offered; if the implementation has no {name}, set "
            f"{entity} = false in [pics]"
        )
        bench.inconclusive(f"{name} registered under protocol identifier {prot_id}", observed, *requirements)
    return bench.present(shown, f"{name} registered under protocol identifier {prot_id}", *requirements)


def _may_be_missing(bench: Bench, name: str) -> bool:
    """Return whether SRP or VarDis may be missing: no entry in the PICS, and no service is offered."""
    upper = bench.session.upper
    prefixes = {"SRP": ("SRP-",), "VarDis": ("RTDB-", "VD-")}[name]
    offered = upper is not None and any(method.startswith(prefixes) for method in upper.methods)
    return getattr(bench.sut.pics, name.lower()) is None and not offered


def check_registered_name(bench: Bench, shown: object, title: str) -> None:
    """Check the name of a registered protocol: ``title`` and a version, which is reported."""
    match = re.fullmatch(re.escape(title) + r" V(\d+\.\d+)", str(shown))
    first, last = min(SpecVersion), max(SpecVersion)
    known = match is not None and first <= match[1] <= last
    bench.proved(known, f"the name '{title} Vx.y', V{first} to V{last}", repr(str(shown)))
    if match is not None:
        bench.info("Which version does the name of the protocol have? (X31)", f"V{match[1]}")


def max_repetitions(bench: Bench) -> int:
    """Return VARDISPAR_MAX_REPETITIONS, limited to 15 to keep cases short."""
    return bench.sut.rep_cnt(15)


def least_left(bench: Bench, count: int, since: int) -> int:
    """Return the minimum number of remaining repetitions, of ``count`` that began after a mark.

    Each beacon since then may have had one, and the next two may already be prepared.
    """
    bench.mark()
    return max(0, count - 2 - (len(bench.heard) - since))


def several_repetitions(bench: Bench) -> str | None:
    """Return why a case that needs three repetitions does not apply, or None."""
    most = bench.sut.parameter("VARDISPAR_MAX_REPETITIONS")
    return None if most >= 3 else f"VARDISPAR_MAX_REPETITIONS is {most}; the case needs 3"


def holds_two_octets(bench: Bench) -> str | None:
    """Return why a case that needs values of two octets does not apply, or None."""
    most = bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH")
    return None if most >= 2 else f"VARDISPAR_MAX_VALUE_LENGTH is {most}; the case needs 2"


def binary_identifiers(bench: Bench) -> str | None:
    """Return why a case about the octets of node identifiers does not apply, or None."""
    return "identifiers are text" if bench.profile.types.node_id.representation == "text" else None


def count_of(bench: Bench, name: str) -> int:
    """Return the number of repetitions that a variant names: a number, or ``most``."""
    return max_repetitions(bench) if name == "most" else min(int(name), max_repetitions(bench))


@contextmanager
def parameters_set(bench: Bench, protocol: str, **values: int) -> Iterator[None]:
    """Set parameters of ``BP``, ``SRP`` or ``VD``, in this order, and restore them at the end of the block.

    Stops as inconclusive if a value is rejected: cases that test whether a value is accepted do not use this.
    """
    old = {name: bench.sut.parameter(name) for name in values}
    try:
        for name, value in values.items():
            bench.must(f"{protocol}-SetParameter", name=name, value=value)
        yield
    finally:
        for name in reversed(old):
            bench.call(f"{protocol}-SetParameter", name=name, value=old[name])


# -- SRP ---------------------------------------------------------------------------------------------------------------


def safety_data(bench: Bench, number: int) -> dict[str, int | float | str]:
    """Return values for all fields of the profile's SafetyDataT in JSON form, different for each ``number``.

    The values are small integers, which every field type can hold exactly.
    """
    values: dict[str, int | float | str] = {}
    for index, field in enumerate(bench.profile.srp.safety_data):
        small = (7 * number + 3 * index + 1) % 100
        values[field.name] = bytes([small] * field.octets).hex() if field.type == "opaque" else small
    return values


def numeric_data(bench: Bench, number: int) -> dict[str, Any]:
    """Return the numeric fields of :func:`safety_data`, as keyword arguments of :meth:`.Records.report`."""
    kinds = {each.name: each.type for each in bench.profile.srp.safety_data}
    return {name: value for name, value in safety_data(bench, number).items() if kinds[name] != "opaque"}


def reported_safety_data(bench: Bench, report: Any) -> dict[str, Any]:
    """Return the safety data of a received report, in the form of :func:`safety_data`."""
    values = report.s_data.as_dict().values()
    names = (field.name for field in bench.profile.srp.safety_data)
    return {name: value.hex() if isinstance(value, bytes) else value for name, value in zip(names, values, strict=True)}


def report_octets(bench: Bench) -> int:
    """Return ssizeof(ExtendedSafetyDataT)."""
    return len(bench.builder.srp(bench.records.report(bench.identifiers.node_id(), 0)).octets)


def srp_blocks(heard: ReceivedBeacon) -> list[bytes]:
    """Return the SRP payloads of a beacon as octets, whether they are state reports or not."""
    return heard.data(BP_PROTID_SRP)


def until_report(bench: Bench, values: dict[str, Any] | None = None) -> ReceivedBeacon | None:
    """Wait for a beacon with a state report with these values, or with any.

    Stops as inconclusive if there are only SRP payloads that cannot be decoded: TC_SRP_REC_BV_01 fails for them.
    """
    start = len(bench.heard)

    def wanted(heard: ReceivedBeacon) -> bool:
        return heard.report is not None and (values is None or reported_safety_data(bench, heard.report) == values)

    found = bench.until(lambda heard: heard if wanted(heard) else None)
    if found is None:
        problems = [each for heard in bench.heard[start:] for each in heard.report_problems]
        if problems:
            bench.inconclusive("a state report that can be decoded", f"{len(problems)} that cannot: {problems[0]}")
    return found


def nanoseconds(bench: Bench, ticks: int) -> int:
    """Return a time stamp of a record, or a difference of two, in ns."""
    return bench.profile.types.timestamp.nanoseconds(ticks)


def neighbours(bench: Bench) -> dict[bytes, list[dict[str, Any]]]:
    """Return the neighbour table by node identifier; as lists, so that duplicate entries can be detected."""
    found: dict[bytes, list[dict[str, Any]]] = {}
    for row in rows(bench.must("SRP-NeighbourTable"), "neighbours"):
        found.setdefault(_octets(row.get("nodeId")), []).append(row)
    return found


def _octets(node_id: Any) -> bytes:
    try:
        return node_id_octets(str(node_id)[:100])
    except ValueError as error:
        raise UpperTesterError(f"nodeId: {error}") from None


def neighbour(bench: Bench, node_id: bytes) -> dict[str, Any] | None:
    """Return the entry of a node; None if there is none."""
    return next(iter(neighbours(bench).get(node_id, ())), None)


def until_neighbour(bench: Bench, node_id: bytes, seqno: int | None = None) -> dict[str, Any] | None:
    """Wait for the entry of a node, with this seqno unless None; None if it does not appear in time."""
    deadline = bench.now() + round(bench.sut.reaction * bench.period)
    while True:
        entry = neighbour(bench, node_id)
        if entry is not None and seqno in (None, entry.get("seqno")):
            return entry
        if bench.now() >= deadline:
            return None
        bench.wait(0.1)
