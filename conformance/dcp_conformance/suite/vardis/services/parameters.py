"""dcp-vardis.md: Configurable Parameters.

A value counts as accepted if VD-GetParameters returns it afterwards; how a rejection is reported is up to the
implementation.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcp_spec.constants import ICType, SpecVersion
from dcp_spec.parameters import parameters

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.bp_clients import block_header_octets, header_octets
from dcp_conformance.test_steps.services import (
    DESCRIPTION_TOO_LONG,
    ILLEGAL_REPCOUNT,
    OK,
    VALUE_TOO_LONG,
    create_request,
    described,
    longest_description,
    parameters_set,
    produced,
    settled,
    several_repetitions,
)
from dcp_conformance.test_system.bench import Bench

_VALUE, _DESCR = "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH"
_REPETITIONS, _PAYLOAD = "VARDISPAR_MAX_REPETITIONS", "VARDISPAR_MAX_PAYLOAD_SIZE"
_SUMMARIES = "VARDISPAR_MAX_SUMMARIES"
_SCRUBBING, _CHECKING = "VARDISPAR_SCRUBBING_PERIOD", "VARDISPAR_BUFFER_CHECK_PERIOD"
_GET, _SET = "VD-GetParameters", "VD-SetParameter"
_PARAMETERS = Needs(ut=(_GET, _SET))


#: The smallest maximum length that can be reduced, even if it counts a NUL.
_LOWERED = 3
#: How far beyond the limit a rejected value may be at most.
_BEYOND = 3


def _in_force(bench: Bench, name: str) -> Any:
    return bench.must(_GET).result.get("parameters", {}).get(name)


@contextmanager
def _kept(bench: Bench, name: str) -> Iterator[None]:
    """Restore the old value of a parameter at the end of the block."""
    old = bench.sut.parameter(name)
    try:
        yield
    finally:
        bench.call(_SET, name=name, value=old)


def _check_taken(bench: Bench, name: str, *values: int) -> None:
    for value in values:
        bench.call(_SET, name=name, value=value)
        bench.answered(_in_force(bench, name), value, f"{name} after a valid value was set")


def _check_refused(bench: Bench, name: str, *values: float) -> None:
    for value in values:
        before = _in_force(bench, name)
        bench.call(_SET, name=name, value=value)
        shown = _in_force(bench, name)
        # Rejected values are just beyond a limit; one further if it is open whether a NUL counts.
        nearest = shown != before and shown != value and abs(shown - value) <= _BEYOND
        if nearest and name.startswith("VARDISPAR_"):
            bench.reading("X39", "nearest-value")
            continue
        bench.answered(shown, before, f"{name} after {value} was rejected")


def _is_least(bench: Bench, name: str) -> str | None:
    """Return why a maximum length cannot be reduced, or None; for ``Needs.when``."""
    return (
        f"{name} is {bench.sut.parameter(name)} and cannot be reduced" if bench.sut.parameter(name) < _LOWERED else None
    )


def _no_way_to_learn(bench: Bench) -> str | None:
    """Return why the maximum lengths of value and description cannot be determined, or None; for ``Needs.when``."""
    if bench.services.offers(_GET) or bench.services.offers("RTDB-Create"):
        return None
    return f"the upper tester does not offer {_GET} or RTDB-Create"


def _tried(bench: Bench, name: str) -> str | int:
    """Return 32 if RTDB-Create accepts 32 octets and rejects 33; otherwise describe the answers."""
    answers = []
    # In 1.0 the length of a description includes the NUL at its end.
    nul = name == _DESCR and bench.features.string_format == "nul-terminated"
    for length in (32 - nul, 33 - nul):
        request = {"value": b"v" * length} if name == _VALUE else {"descr": "d" * length}
        answers.append(
            bench.call("RTDB-Create", **create_request(bench, bench.identifiers.own_var_id(), exact=True, **request))
        )
    if answers[0].ok and not answers[1].ok:
        return 32
    return f"32 octets: {answers[0]}, 33 octets: {answers[1]}"


def _ic_header(bench: Bench) -> int:
    return len(bench.builder.empty_container(bench.builder.ic_type(ICType.SUMMARIES)))


def _bare_create(bench: Bench) -> int:
    """Return the size in octets of a container with a VarCreate without description and value, up to their length
    fields, and without the octets of added blocks, of which samples have one each.
    """
    bare = bench.builder.container_header_size + bench.builder.record_size(bench.records.sample(descr=b"", value=b""))
    blocks = sum(each.block is not None for each in bench.profile.own_fields().get("VarSpec", ()))
    return bare - (1 if bench.profile.types.string.terminated else 0) - blocks


def _largest_length(bench: Bench) -> int:
    """Return the largest VarLenT."""
    return int((1 << (8 * bench.profile.types.value.lengths[0].width)) - 1)


@case(
    "TC_VD_PAR_BV_01",
    "The maximum lengths of value and description are 32 octets by default",
    requirements="VD-PAR-02 VD-PAR-03",
    stimulus="VD-GetParameters; without it, RTDB-Create with 32 octets and with 33",
    expect="32 for both; another value may have been configured and is reported",
    needs=Needs(when=_no_way_to_learn),
)
def defaults(bench: Bench) -> None:
    for name, requirement in ((_VALUE, "VD-PAR-02"), (_DESCR, "VD-PAR-03")):
        shown = _in_force(bench, name) if _GET in bench.services.upper.methods else _tried(bench, name)
        if shown in (None, 32):
            bench.answered(shown, 32, name, requirement)
        else:
            bench.info(f"Is {name} 32 octets, the default?", f"{shown}", requirement)


@case(
    "TC_VD_PAR_BI_01",
    "The limits of VARDISPAR_MAX_VALUE_LENGTH",
    requirements="VD-PAR-02",
    stimulus=(
        "VD-SetParameter with 1, with the largest value that VarLenT and payload size allow, with 0 and with one "
        "more than the largest"
    ),
    expect="the first two values are accepted, the others rejected (in 1.0 the payload size does not matter)",
    needs=_PARAMETERS,
)
def value_length(bench: Bench) -> None:
    largest = _largest_length(bench)
    if bench.profile.spec_version >= SpecVersion.V1_1:
        largest = min(largest, bench.sut.parameter(_PAYLOAD) - _ic_header(bench))
    fits = bench.sut.parameter(_PAYLOAD) - _bare_create(bench) - bench.sut.parameter(_DESCR)
    with _kept(bench, _VALUE):
        # Whether values may be longer than the room beside the longest description is disputed (X23).
        _check_taken(bench, _VALUE, 1, min(largest, fits))
        _check_refused(bench, _VALUE, 0, largest + 1)


@case(
    "TC_VD_PAR_BI_02",
    "VARDISPAR_MAX_VALUE_LENGTH is limited by the payload size minus a container header",
    requirements="VD-PAR-02",
    stimulus="VARDISPAR_MAX_PAYLOAD_SIZE is reduced; VD-SetParameter with the limit and with one more",
    expect="the limit is accepted, or rejected because no VarCreate would fit (X23); one more is rejected",
    needs=Needs(since=SpecVersion.V1_1, ut=(_GET, _SET)),
)
def value_length_and_payload(bench: Bench) -> None:
    payload = _bare_create(bench) + bench.sut.parameter(_DESCR) + bench.sut.parameter(_VALUE) + 8
    bound = payload - _ic_header(bench)
    if bound + 1 > _largest_length(bench):
        bench.inconclusive("a payload size whose limit is below the largest VarLenT", f"impossible with {payload}")
    with parameters_set(bench, "VD", **{_PAYLOAD: payload}), _kept(bench, _VALUE):
        answer = bench.call(_SET, name=_VALUE, value=bound)
        taken = _in_force(bench, _VALUE) == bound
        bench.answered(answer.ok, taken, f"status OK for {_VALUE} = {bound} if and only if it is in force")
        # The longest value with which a VarCreate with the longest description fits.
        fits = bench.sut.parameter(_VALUE) + 8
        if taken:
            bench.reading("X23", "literal-bound")
        elif bench.call(_SET, name=_VALUE, value=fits).ok and _in_force(bench, _VALUE) == fits:
            bench.reading("X23", "record-bound")
        _check_refused(bench, _VALUE, bound + 1)


@case(
    "TC_VD_PAR_BI_03",
    "The limits of VARDISPAR_MAX_DESCRIPTION_LENGTH",
    requirements="VD-PAR-03",
    stimulus=(
        "VARDISPAR_MAX_PAYLOAD_SIZE is reduced to determine the limit; VD-SetParameter with 1, the limit, 0 and "
        "one more than the limit"
    ),
    expect="the first two values are accepted, the others rejected",
    needs=_PARAMETERS,
)
def description_length(bench: Bench) -> None:
    bound = bench.sut.parameter(_DESCR) + 8
    payload = _bare_create(bench) + bench.sut.parameter(_VALUE) + bound
    # In 1.0 the specification does not say whether the NUL counts.
    slack = 1 if bench.features.string_format == "nul-terminated" else 0
    with parameters_set(bench, "VD", **{_PAYLOAD: payload}), _kept(bench, _DESCR):
        _check_taken(bench, _DESCR, 1, bound - slack)
        _check_refused(bench, _DESCR, 0, bound + 1 + slack)


@case(
    "TC_VD_PAR_BI_09",
    "The limit of VARDISPAR_MAX_DESCRIPTION_LENGTH depends on the current maximum value length",
    requirements="VD-PAR-03",
    stimulus=(
        "VARDISPAR_MAX_PAYLOAD_SIZE is reduced to determine the limit; VARDISPAR_MAX_VALUE_LENGTH and "
        "VARDISPAR_MAX_REPETITIONS are changed; VD-SetParameter with one more than the limit, then the limit"
    ),
    expect="the limit is accepted, one more is rejected",
    needs=Needs(since=SpecVersion.V1_1, ut=(_GET, _SET)),
)
def description_length_beside_values(bench: Bench) -> None:
    value, bound = bench.sut.parameter(_VALUE), bench.sut.parameter(_DESCR) + 12
    value += 8 if value + 8 <= _largest_length(bench) else -8
    payload = _bare_create(bench) + value + bound
    with parameters_set(bench, "VD", **{_PAYLOAD: payload, _VALUE: value, _REPETITIONS: 2}), _kept(bench, _DESCR):
        _check_refused(bench, _DESCR, bound + 1)
        _check_taken(bench, _DESCR, bound)


@case(
    "TC_VD_PAR_BI_04",
    "The limits of VARDISPAR_MAX_REPETITIONS",
    requirements="VD-PAR-04 VD-PAR-10",
    stimulus="VD-SetParameter with 1, 15, 0 and 16",
    expect="the first two values are accepted, the others rejected; 1.1 has no upper limit (X25)",
    needs=_PARAMETERS,
)
def repetitions(bench: Bench) -> None:
    bound = bench.features.max_repetitions_bound
    with _kept(bench, _REPETITIONS):
        _check_taken(bench, _REPETITIONS, 1, 15)
        _check_refused(bench, _REPETITIONS, 0)
        if bound is None:
            _check_taken(bench, _REPETITIONS, 16)
        else:
            _check_refused(bench, _REPETITIONS, bound + 1)


@case(
    "TC_VD_PAR_BI_05",
    "The limits of VARDISPAR_MAX_PAYLOAD_SIZE",
    requirements="VD-PAR-05",
    stimulus="VD-SetParameter with 0, with the room in a packet after both headers, and with one more",
    expect="only the second value is accepted; 1.0 has a lower limit only",
    needs=_PARAMETERS,
    # VarDis may be registered with a larger payload size afterwards.
    destructive=True,
)
def payload_size(bench: Bench) -> None:
    with _kept(bench, _PAYLOAD):
        _check_refused(bench, _PAYLOAD, 0)
        if bench.profile.spec_version >= SpecVersion.V1_1:
            headers = header_octets(bench) + block_header_octets(bench)
            bound = bench.sut.parameter("BPPAR_MAXIMUM_PACKET_SIZE") - headers
            _check_taken(bench, _PAYLOAD, bound)
            _check_refused(bench, _PAYLOAD, bound + 1)


@case(
    "TC_VD_PAR_BI_06",
    "The limits of VARDISPAR_MAX_SUMMARIES",
    requirements="VD-PAR-06",
    stimulus="VD-SetParameter with 0, with the number that fits into a payload, with one more, and with -1",
    expect="the first two values are accepted, the others rejected; 1.0 has a lower limit only",
    needs=_PARAMETERS,
)
def summaries(bench: Bench) -> None:
    peer = bench.peer()
    bound = (bench.sut.parameter(_PAYLOAD) - _ic_header(bench)) // bench.builder.record_size(peer.summary(0, 0))
    with _kept(bench, _SUMMARIES):
        _check_taken(bench, _SUMMARIES, 0)
        _check_refused(bench, _SUMMARIES, -1)
        if bench.profile.spec_version >= SpecVersion.V1_1:
            _check_taken(bench, _SUMMARIES, bound)
            _check_refused(bench, _SUMMARIES, bound + 1)


@case(
    "TC_VD_PAR_BI_07",
    "The limits of VARDISPAR_SCRUBBING_PERIOD",
    requirements="VD-PAR-07",
    stimulus="VD-SetParameter with 1, 65000, 0, 65001 and 1.5",
    expect="the first two values are accepted, the others rejected",
    needs=Needs(since=SpecVersion.V2_0, ut=(_GET, _SET)),
    # A period of one minute may have begun before the old value is restored.
    destructive=True,
)
def scrubbing_period(bench: Bench) -> None:
    with _kept(bench, _SCRUBBING):
        _check_refused(bench, _SCRUBBING, 0, 65001, 1.5)
        _check_taken(bench, _SCRUBBING, 65000, 1)


@case(
    "TC_VD_PAR_BI_08",
    "The limits of VARDISPAR_BUFFER_CHECK_PERIOD",
    requirements="VD-PAR-08",
    stimulus="VD-SetParameter with 1, 65000, 0 and 65001",
    expect="the first two values are accepted, the others rejected; up to 1.1 there is a lower limit only",
    needs=_PARAMETERS,
    destructive=True,
)
def buffer_check_period(bench: Bench) -> None:
    with _kept(bench, _CHECKING):
        _check_refused(bench, _CHECKING, 0)
        if bench.profile.spec_version >= SpecVersion.V1_2:
            _check_refused(bench, _CHECKING, 65001)
        _check_taken(bench, _CHECKING, 65000, 1)


# -- effects -----------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_PAR_BV_02",
    "A reduced maximum description length applies to new variables, not to existing ones",
    requirements="VD-PAR-01",
    stimulus=(
        "RTDB-Create with the longest description; the maximum is reduced by one; RTDB-Create with the same length "
        "and with one octet less"
    ),
    expect="the second is rejected, the third created; the first still has its full description",
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-DescribeVariable"), when=lambda bench: _is_least(bench, _DESCR)),
)
def description_effect(bench: Bench) -> None:
    longest = longest_description(bench)
    old = produced(bench, descr="d" * longest)
    with parameters_set(bench, "VD", **{_DESCR: bench.sut.parameter(_DESCR) - 1}):
        request = create_request(bench, bench.unknown_id(), descr="d" * longest)
        bench.expect_status(DESCRIPTION_TOO_LONG, "RTDB-Create", **request)
        request = create_request(bench, bench.identifiers.own_var_id(), descr="d" * (longest - 1))
        bench.expect_status(OK, "RTDB-Create", **request)
        answer = bench.expect_status(OK, "RTDB-DescribeVariable", varId=old)
        bench.answered(described(answer).get("descr"), "d" * longest, "the full description of the old variable")


@case(
    "TC_VD_PAR_BV_03",
    "A reduced maximum value length applies to new values, not to stored ones",
    requirements="VD-PAR-01",
    stimulus=(
        "RTDB-Create with the longest value; the maximum is reduced by one; an update of the same length, and one "
        "an octet shorter"
    ),
    expect="RTDB-Read returns the full old value; the first update is rejected, the second accepted",
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-Update", "RTDB-Read"), when=lambda bench: _is_least(bench, _VALUE)),
)
def value_effect(bench: Bench) -> None:
    longest = bench.sut.bound(_VALUE)
    var_id = produced(bench, value=b"v" * longest)
    with parameters_set(bench, "VD", **{_VALUE: longest - 1}):
        answer = bench.expect_status(OK, "RTDB-Read", varId=var_id)
        bench.answered(answer.result.get("value"), (b"v" * longest).hex(), "the old value unchanged")
        bench.expect_status(VALUE_TOO_LONG, "RTDB-Update", varId=var_id, value=(b"w" * longest).hex())
        bench.expect_status(OK, "RTDB-Update", varId=var_id, value=(b"w" * (longest - 1)).hex())


@case(
    "TC_VD_PAR_BV_04",
    "A reduced maximum repetition count applies to new variables",
    requirements="VD-PAR-01",
    stimulus=(
        "RTDB-Create with repCnt 3; the maximum is set to 2; RTDB-Create with 3 and with 2; an update of the first "
        "variable"
    ),
    expect="repCnt 3 is rejected, 2 accepted; the old variable keeps repCnt 3",
    window=25,
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-Update"), when=several_repetitions),
)
def repetitions_effect(bench: Bench) -> None:
    old = produced(bench, rep_cnt=bench.sut.rep_cnt(3))
    settled(bench, old)
    with parameters_set(bench, "VD", **{_REPETITIONS: 2}):
        bench.expect_status(ILLEGAL_REPCOUNT, "RTDB-Create", **create_request(bench, bench.unknown_id(), rep_cnt=3))
        bench.expect_status(OK, "RTDB-Create", **create_request(bench, bench.identifiers.own_var_id(), rep_cnt=2))
        mark = bench.mark()
        bench.must("RTDB-Update", varId=old, value=bench.records.value(b"newer").hex())
        frames = bench.until_quiet(lambda heard: heard.instructions(ICType.UPDATES, old), since=mark)
        # The parameter limits the contents of beacons, which can also be read as a limit of 2 from now on.
        bench.repeated(frames, 2, "beacons with its VarUpdate", most=3)
        bench.info("How many repetitions does a variable with more than the new maximum get?", f"{len(frames)} of 3")


@case(
    "TC_VD_PAR_BV_05",
    "Payloads have at most VARDISPAR_MAX_SUMMARIES summaries ({variant})",
    requirements="VD-PAR-06 VD-PAR-01",
    stimulus="five variables; VARDISPAR_MAX_SUMMARIES = {variant}",
    expect=(
        "after at most one beacon prepared before, at most {variant} summaries in each payload; with 0 no "
        "SUMMARIES container"
    ),
    window=16,
    needs=Needs(ut=(_SET, "RTDB-Create")),
    variants={"0": 0, "2": 2},
)
def summaries_effect(bench: Bench, most: int) -> None:
    for _ in range(5):
        produced(bench)
    with parameters_set(bench, "VD", **{_SUMMARIES: most}):
        # The new variables cause beacons for a while; after that there are only summaries.
        for _ in range(2):
            produced(bench, rep_cnt=bench.sut.rep_cnt(3))
        bench.mark()
        bench.beacons(1)
        mark = bench.mark()
        bench.wait(5)
        frames = bench.heard[mark:]
        bench.every(
            frames,
            lambda heard: len(heard.instructions(ICType.SUMMARIES)) <= most,
            f"at most {most} summaries in each beacon",
        )
        if most:
            some = any(heard.instructions(ICType.SUMMARIES) for heard in frames)
            bench.some(some, "at least one summary", seen=f"none in {len(frames)} beacons")
    bench.require_alive("a new maximum number of summaries")


@case(
    "TC_VD_PAR_BV_06",
    "All configurable parameters of the version exist and can be set",
    requirements="VD-PAR-09",
    stimulus="VD-GetParameters; VD-SetParameter for each parameter of the version, with its current value",
    expect="VD-GetParameters returns each parameter, with the same value afterwards",
    needs=_PARAMETERS,
)
def complete(bench: Bench) -> None:
    version = bench.profile.spec_version
    named = [name for name, each in parameters().items() if each.protocol == "VD" and each.since <= version]
    told = bench.must(_GET).result.get("parameters", {})
    for name in named:
        bench.proved(name in told, f"{name} exists", "not returned by VD-GetParameters")
        if name in told:
            bench.must(_SET, name=name, value=told[name])
            bench.answered(_in_force(bench, name), told[name], f"{name} after it was set to the value that it had")
