"""dcp-vardis.md: Configurable Parameters.

A value is taken when VD-GetParameters shows it afterwards; how a refusal is reported is left to the implementation.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcp_spec.constants import ICType, SpecVersion
from dcp_spec.parameters import parameters

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.forge import Block
from dcp_conformance.services import (
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

_VALUE, _DESCR = "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH"
_REPETITIONS, _PAYLOAD = "VARDISPAR_MAX_REPETITIONS", "VARDISPAR_MAX_PAYLOAD_SIZE"
_SUMMARIES = "VARDISPAR_MAX_SUMMARIES"
_SCRUBBING, _CHECKING = "VARDISPAR_SCRUBBING_PERIOD", "VARDISPAR_BUFFER_CHECK_PERIOD"
_GET, _SET = "VD-GetParameters", "VD-SetParameter"
_PARAMETERS = Needs(ut=(_GET, _SET))


#: The least maximum length that can be lowered, also where it counts a NUL.
_LOWERED = 3
#: How far beyond a bound the values are that must not be taken.
_BEYOND = 3


def _in_force(bench: Bench, name: str) -> Any:
    return bench.must(_GET).result.get("parameters", {}).get(name)


@contextmanager
def _kept(bench: Bench, name: str) -> Iterator[None]:
    """Whatever is tried with the parameter, it has its old value afterwards."""
    old = bench.parameter(name)
    try:
        yield
    finally:
        bench.call(_SET, name=name, value=old)


def _check_taken(bench: Bench, name: str, *values: int) -> None:
    for value in values:
        answer = bench.call(_SET, name=name, value=value)
        shown = _in_force(bench, name)
        bench.check(shown == value, f"{name} = {value} is taken", f"{answer}; it is {shown}", shown=True)


def _check_refused(bench: Bench, name: str, *values: float) -> None:
    for value in values:
        before = _in_force(bench, name)
        answer = bench.call(_SET, name=name, value=value)
        shown = _in_force(bench, name)
        # What is refused here lies just beyond a bound; further, where it is open whether a NUL counts.
        nearest = shown != before and shown != value and abs(shown - value) <= _BEYOND
        if nearest and name.startswith("VARDISPAR_"):
            bench.reading("X39", "nearest-value")
            continue
        what = f"{name} = {value} is not taken"
        bench.check(shown == before, what, f"{answer}; it is {shown}, was {before}", shown=True)


def _is_least(bench: Bench, name: str) -> str | None:
    """For ``Needs.when``: why a maximum length cannot be lowered."""
    return f"{name} is {bench.parameter(name)}, and cannot be lowered" if bench.parameter(name) < _LOWERED else None


def _no_way_to_learn(bench: Bench) -> str | None:
    """For ``Needs.when``: why the longest value and description cannot be found out."""
    upper = bench.session.upper
    if upper is not None and ({_GET} <= upper.methods or {"RTDB-Create"} <= upper.methods):
        return None
    return f"the upper tester does not offer {_GET} or RTDB-Create"


def _tried(bench: Bench, name: str) -> str | int:
    """32 if so many octets are taken and 33 are not; else what happens."""
    answers = []
    # In 1.0 the length of a description counts the NUL at its end.
    nul = name == _DESCR and bench.features.string_format == "nul-terminated"
    for length in (32 - nul, 33 - nul):
        request = {"value": b"v" * length} if name == _VALUE else {"descr": "d" * length}
        answers.append(bench.call("RTDB-Create", **create_request(bench, bench.own_var_id(), exact=True, **request)))
    if answers[0].ok and not answers[1].ok:
        return 32
    return f"32 octets: {answers[0]}, 33 octets: {answers[1]}"


def _ic_header(bench: Bench) -> int:
    return len(bench.forge.empty_container(bench.forge.ic_type(ICType.SUMMARIES)))


def _bare_create(bench: Bench) -> int:
    """Octets of a container with a VarCreate without description and value, up to their lengths."""
    bare = len(bench.forge.container(bench.sample(descr=b"", value=b"")))
    return bare - (1 if bench.profile.types.string.terminated else 0)


def _largest_length(bench: Bench) -> int:
    """The largest VarLenT."""
    return int((1 << (8 * bench.profile.types.value.lengths[0].width)) - 1)


@case(
    "TC_VD_PAR_BV_01",
    "The longest value and description are 32 octets unless it was configured otherwise",
    requirements="VD-PAR-02 VD-PAR-03",
    stimulus="VD-GetParameters; without it, RTDB-Create with 32 octets and with 33",
    expect="32 for both; another value is reported, for it may have been configured",
    needs=Needs(when=_no_way_to_learn),
)
def defaults(bench: Bench) -> None:
    for name, requirement in ((_VALUE, "VD-PAR-02"), (_DESCR, "VD-PAR-03")):
        shown = _in_force(bench, name) if _GET in bench.ut.methods else _tried(bench, name)
        if shown in (None, 32):
            bench.check(shown == 32, f"{name} is 32", "it is not told", requirement, shown=True)
        else:
            bench.info(f"{name}, by default 32", f"{shown}", requirement)


@case(
    "TC_VD_PAR_BI_01",
    "The bounds of VARDISPAR_MAX_VALUE_LENGTH",
    requirements="VD-PAR-02",
    stimulus="set 1, the largest that VarLenT and payload allow, 0 and one more than the largest",
    expect="the first two are taken, the others not (1.0 has no bound by the payload)",
    needs=_PARAMETERS,
)
def value_length(bench: Bench) -> None:
    largest = _largest_length(bench)
    if bench.profile.spec_version >= SpecVersion.V1_1:
        largest = min(largest, bench.parameter(_PAYLOAD) - _ic_header(bench))
    fits = bench.parameter(_PAYLOAD) - _bare_create(bench) - bench.parameter(_DESCR)
    with _kept(bench, _VALUE):
        # Beyond what fits beside the longest description the bound is disputed (X23).
        _check_taken(bench, _VALUE, 1, min(largest, fits))
        _check_refused(bench, _VALUE, 0, largest + 1)


@case(
    "TC_VD_PAR_BI_02",
    "VARDISPAR_MAX_VALUE_LENGTH is below the payload size without a container header",
    requirements="VD-PAR-02",
    stimulus="lower VARDISPAR_MAX_PAYLOAD_SIZE; set the bound, and one more",
    expect="the bound is taken, or refused because no VarCreate would fit (X23); one more is refused",
    needs=Needs(since=SpecVersion.V1_1, ut=(_GET, _SET)),
)
def value_length_and_payload(bench: Bench) -> None:
    payload = _bare_create(bench) + bench.parameter(_DESCR) + bench.parameter(_VALUE) + 8
    bound = payload - _ic_header(bench)
    if bound + 1 > _largest_length(bench):
        bench.inconclusive("a payload size whose bound is below the largest VarLenT", f"{payload} is not")
    with parameters_set(bench, "VD", **{_PAYLOAD: payload}), _kept(bench, _VALUE):
        answer = bench.call(_SET, name=_VALUE, value=bound)
        taken = _in_force(bench, _VALUE) == bound
        bench.check(
            taken == answer.ok, f"{_VALUE} = {bound} is taken exactly if the confirm says so", str(answer), shown=True
        )
        # The longest value for which a VarCreate with the longest description fits.
        fits = bench.parameter(_VALUE) + 8
        if taken:
            bench.reading("X23", "literal-bound")
        elif bench.call(_SET, name=_VALUE, value=fits).ok and _in_force(bench, _VALUE) == fits:
            bench.reading("X23", "record-bound")
        _check_refused(bench, _VALUE, bound + 1)


@case(
    "TC_VD_PAR_BI_03",
    "The bounds of VARDISPAR_MAX_DESCRIPTION_LENGTH",
    requirements="VD-PAR-03",
    stimulus="lower VARDISPAR_MAX_PAYLOAD_SIZE so that it decides; set 1, the bound, 0 and one more than the bound",
    expect="the first two are taken, the others not",
    needs=_PARAMETERS,
)
def description_length(bench: Bench) -> None:
    bound = bench.parameter(_DESCR) + 8
    payload = _bare_create(bench) + bench.parameter(_VALUE) + bound
    # In 1.0 it is not said whether the NUL counts.
    slack = 1 if bench.features.string_format == "nul-terminated" else 0
    with parameters_set(bench, "VD", **{_PAYLOAD: payload}), _kept(bench, _DESCR):
        _check_taken(bench, _DESCR, 1, bound - slack)
        _check_refused(bench, _DESCR, 0, bound + 1 + slack)


@case(
    "TC_VD_PAR_BI_09",
    "The bound of VARDISPAR_MAX_DESCRIPTION_LENGTH follows the value length that is set",
    requirements="VD-PAR-03",
    stimulus="lower VARDISPAR_MAX_PAYLOAD_SIZE so that it decides, set another VARDISPAR_MAX_VALUE_LENGTH, then "
    "another VARDISPAR_MAX_REPETITIONS; set the bound, and one more",
    expect="the bound is taken, one more is not",
    needs=Needs(since=SpecVersion.V1_1, ut=(_GET, _SET)),
)
def description_length_beside_values(bench: Bench) -> None:
    value, bound = bench.parameter(_VALUE), bench.parameter(_DESCR) + 12
    value += 8 if value + 8 <= _largest_length(bench) else -8
    payload = _bare_create(bench) + value + bound
    with parameters_set(bench, "VD", **{_PAYLOAD: payload, _VALUE: value, _REPETITIONS: 2}), _kept(bench, _DESCR):
        _check_refused(bench, _DESCR, bound + 1)
        _check_taken(bench, _DESCR, bound)


@case(
    "TC_VD_PAR_BI_04",
    "The bounds of VARDISPAR_MAX_REPETITIONS",
    requirements="VD-PAR-04 VD-PAR-10",
    stimulus="set 1, 15, 0 and 16",
    expect="the first two are taken, the others not; 1.1 has no upper bound (X25)",
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
    "The bounds of VARDISPAR_MAX_PAYLOAD_SIZE",
    requirements="VD-PAR-05",
    stimulus="set what fits into a packet beside both headers, one more, and 0",
    expect="the first is taken, the others not; 1.0 has only the lower bound",
    needs=_PARAMETERS,
    # It may be registered for larger payloads afterwards.
    destructive=True,
)
def payload_size(bench: Bench) -> None:
    with _kept(bench, _PAYLOAD):
        _check_refused(bench, _PAYLOAD, 0)
        if bench.profile.spec_version >= SpecVersion.V1_1:
            headers = len(bench.peer().beacon(Block(2, b"")))
            bound = bench.parameter("BPPAR_MAXIMUM_PACKET_SIZE") - headers
            _check_taken(bench, _PAYLOAD, bound)
            _check_refused(bench, _PAYLOAD, bound + 1)


@case(
    "TC_VD_PAR_BI_06",
    "The bounds of VARDISPAR_MAX_SUMMARIES",
    requirements="VD-PAR-06",
    stimulus="set 0, what fits into a payload, one more, and -1",
    expect="the first two are taken, the others not; 1.0 has only the lower bound",
    needs=_PARAMETERS,
)
def summaries(bench: Bench) -> None:
    peer = bench.peer()
    one, two = (len(bench.forge.container(*[peer.summary(0, 0)] * count)) for count in (1, 2))
    bound = (bench.parameter(_PAYLOAD) - _ic_header(bench)) // (two - one)
    with _kept(bench, _SUMMARIES):
        _check_taken(bench, _SUMMARIES, 0)
        _check_refused(bench, _SUMMARIES, -1)
        if bench.profile.spec_version >= SpecVersion.V1_1:
            _check_taken(bench, _SUMMARIES, bound)
            _check_refused(bench, _SUMMARIES, bound + 1)


@case(
    "TC_VD_PAR_BI_07",
    "The bounds of VARDISPAR_SCRUBBING_PERIOD",
    requirements="VD-PAR-07",
    stimulus="set 1, 65000, 0, 65001 and 1.5",
    expect="the first two are taken, the others not",
    needs=Needs(since=SpecVersion.V2_0, ut=(_GET, _SET)),
    # A period of a minute may have begun before the old one is set again.
    destructive=True,
)
def scrubbing_period(bench: Bench) -> None:
    with _kept(bench, _SCRUBBING):
        _check_refused(bench, _SCRUBBING, 0, 65001, 1.5)
        _check_taken(bench, _SCRUBBING, 65000, 1)


@case(
    "TC_VD_PAR_BI_08",
    "The bounds of VARDISPAR_BUFFER_CHECK_PERIOD",
    requirements="VD-PAR-08",
    stimulus="set 1, 65000, 0 and 65001",
    expect="the first two are taken, the others not; up to 1.1 there is only the lower bound",
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
    "A lower maximum description length counts for new variables, not for those there are",
    requirements="VD-PAR-01",
    stimulus="RTDB-Create with the longest description; one octet less as maximum; the same again, and one octet less",
    expect="the second is refused, the third created; the first is still there, described in full",
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-DescribeVariable"), when=lambda bench: _is_least(bench, _DESCR)),
)
def description_effect(bench: Bench) -> None:
    longest = longest_description(bench)
    old = produced(bench, descr="d" * longest)
    with parameters_set(bench, "VD", **{_DESCR: bench.parameter(_DESCR) - 1}):
        request = create_request(bench, bench.unknown_id(), descr="d" * longest)
        bench.expect_status(DESCRIPTION_TOO_LONG, "RTDB-Create", **request)
        request = create_request(bench, bench.own_var_id(), descr="d" * (longest - 1))
        bench.expect_status(OK, "RTDB-Create", **request)
        answer = bench.expect_status(OK, "RTDB-DescribeVariable", varId=old)
        shown = described(answer).get("descr")
        bench.check(shown == "d" * longest, "the old variable has its description", f"{shown}", shown=True)


@case(
    "TC_VD_PAR_BV_03",
    "A lower maximum value length counts for new values, not for those there are",
    requirements="VD-PAR-01",
    stimulus="RTDB-Create with the longest value; one octet less as maximum; an update as long, and one octet shorter",
    expect="the old value is read in full, the first update refused, the second made",
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-Update", "RTDB-Read"), when=lambda bench: _is_least(bench, _VALUE)),
)
def value_effect(bench: Bench) -> None:
    longest = bench.bound(_VALUE)
    var_id = produced(bench, value=b"v" * longest)
    with parameters_set(bench, "VD", **{_VALUE: longest - 1}):
        answer = bench.expect_status(OK, "RTDB-Read", varId=var_id)
        shown = answer.result.get("value")
        bench.check(shown == (b"v" * longest).hex(), "the old value is kept", f"{shown}", shown=True)
        bench.expect_status(VALUE_TOO_LONG, "RTDB-Update", varId=var_id, value=(b"w" * longest).hex())
        bench.expect_status(OK, "RTDB-Update", varId=var_id, value=(b"w" * (longest - 1)).hex())


@case(
    "TC_VD_PAR_BV_04",
    "A lower maximum of repetitions counts for new variables",
    requirements="VD-PAR-01",
    stimulus="RTDB-Create with repCnt 3; a maximum of 2; RTDB-Create with 3 and with 2; an update of the first",
    expect="3 is refused, 2 created; the old variable keeps repCnt 3",
    window=25,
    needs=Needs(ut=(_SET, "RTDB-Create", "RTDB-Update"), when=several_repetitions),
)
def repetitions_effect(bench: Bench) -> None:
    old = produced(bench, rep_cnt=bench.rep_cnt(3))
    settled(bench, old)
    with parameters_set(bench, "VD", **{_REPETITIONS: 2}):
        bench.expect_status(ILLEGAL_REPCOUNT, "RTDB-Create", **create_request(bench, bench.unknown_id(), rep_cnt=3))
        bench.expect_status(OK, "RTDB-Create", **create_request(bench, bench.own_var_id(), rep_cnt=2))
        mark = bench.mark()
        bench.must("RTDB-Update", varId=old, value=bench.value(b"newer").hex())
        frames = bench.until_quiet(lambda heard: heard.instructions(ICType.UPDATES, old), since=mark)
        # That the parameter bounds what goes into beacons can also be read as a limit of 2 from now on.
        bench.check(
            len(frames) in (2, 3),
            "3 beacons carry its VarUpdate (or 2)",
            f"{len(frames)}",
            frames=frames,
            shown=len(frames) > 3,
        )
        bench.info("repetitions of a variable with more than the new maximum", f"{len(frames)} of 3")


@case(
    "TC_VD_PAR_BV_05",
    "With a maximum of {variant} summaries no payload has more",
    requirements="VD-PAR-06 VD-PAR-01",
    stimulus="five variables; VARDISPAR_MAX_SUMMARIES = {variant}",
    expect="after at most one beacon that was prepared before, no more than {variant} summaries; with 0 no container",
    window=16,
    needs=Needs(ut=(_SET, "RTDB-Create")),
    variants={"0": 0, "2": 2},
)
def summaries_effect(bench: Bench, most: int) -> None:
    for _ in range(5):
        produced(bench)
    with parameters_set(bench, "VD", **{_SUMMARIES: most}):
        # The new variables keep beacons coming for a while; then only summaries do.
        for _ in range(2):
            produced(bench, rep_cnt=bench.rep_cnt(3))
        bench.mark()
        bench.beacons(1)
        mark = bench.mark()
        bench.wait(5)
        frames = bench.heard[mark:]
        over = [heard for heard in frames if len(heard.instructions(ICType.SUMMARIES)) > most]
        bench.check(
            not over, f"at most {most} summaries in a beacon", f"{len(over)} beacons have more", frames=over, shown=True
        )
        if most:
            some = any(heard.instructions(ICType.SUMMARIES) for heard in frames)
            bench.check(some, "there are summaries", f"none in {len(frames)} beacons")
    bench.require_alive("a limit of summaries")


@case(
    "TC_VD_PAR_BV_06",
    "All configurable parameters of the version exist and can be set",
    requirements="VD-PAR-09",
    stimulus="VD-GetParameters; each parameter that the version names is set to the value that it has",
    expect="each is told, and has that value afterwards",
    needs=_PARAMETERS,
)
def complete(bench: Bench) -> None:
    version = bench.profile.spec_version
    named = [name for name, each in parameters().items() if each.protocol == "VD" and each.since <= version]
    told = bench.must(_GET).result.get("parameters", {})
    for name in named:
        bench.check(name in told, f"{name} exists", "VD-GetParameters does not tell it", shown=True)
        if name in told:
            bench.must(_SET, name=name, value=told[name])
            shown = _in_force(bench, name)
            bench.check(shown == told[name], f"{name} = {told[name]} is taken", f"it is {shown}", shown=True)
