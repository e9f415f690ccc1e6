"""Drafting a PICS: what is seen and told is stated, everything else is a question."""

from __future__ import annotations

import tomllib
from functools import cache
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED
from dcp_conformance.definitions.declared import denied_by
from dcp_conformance.definitions.pics import UNKNOWN_PROFILE, Capabilities, Pics, Testing, load_pics
from dcp_conformance.definitions.pics_file import QUESTIONS, pics_text, write_pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import TargetOptions, describe
from dcp_conformance.frames.builder import Block, FrameBuilder
from dcp_conformance.interconnection.probe import Period, draft, measured_period, rounded
from dcp_conformance.interconnection.settings import doubtful, ranked_with
from dcp_conformance.lower_tester import Arrival, LinkHealth
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import Answer
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import PROFILES
from dcp_spec.profile.loading import profile_names

from dcp_codec import Codec
from dcp_codec.values import Beacon, BPHeader, VarSumm
from dcp_stack.config import VardisConfig

from ...parts import also
from ..rig import every_case


@cache
def codec(name: str) -> Codec:
    return Codec(name)


CANDIDATES = [codec(name) for name in profile_names()]
#: Without the profile whose SRP payloads are the pattern of the mutant, so that no profile knows the pattern.
WITHOUT_PATTERN = [each for each in CANDIDATES if each.profile.name != "cpp-1.2"]


def node(profile: str, **options: Any) -> InProcess:
    return InProcess(reference_config(codec(profile), **options))


def busy(sut: InProcess, count: int = 3) -> None:
    """Give the node variables to talk about."""
    upper = sut.upper_tester()
    for var_id in range(1, count + 1):
        params = {"varId": var_id, "repCnt": 3, "descr": f"variable {var_id}", "value": "0102"}
        assert upper.call("RTDB-Create", params).ok
    upper.close()


def test_a_draft_from_an_upper_tester():
    sut = node("cpp-1.3", beacon_period_ms=250)
    busy(sut)
    pics, remarks = draft(sut.lower_tester(), sut.upper_tester(), CANDIDATES, 20)
    assert (pics.sut.name, pics.pixit.profile, pics.pixit.node_id) == ("dcp-node", "cpp-1.3", "02:00:00:00:00:01")
    assert pics.pixit.beacon_period_ms == 250
    assert pics.pixit.max_summaries == 20
    assert pics.pixit.max_value_length == codec("cpp-1.3").profile.limits.max_value_length
    assert (pics.pics.srp, pics.pics.vardis, pics.pics.runtime_parameters, pics.pics.jitter) == (True,) * 4
    (measured,) = [each for each in remarks if each.startswith("the beacon period was measured")]
    assert measured.endswith("it says 250 ms")
    # There is no evidence about other properties, so they are not stated.
    assert pics.pics.parameter_feedback is None
    assert pics.pixit.reaction_periods is None


def test_a_draft_without_an_upper_tester():
    sut = node("dcp-2.0", beacon_period_ms=50)
    busy(sut)
    safety_data = {"x": 1, "y": 2, "z": 3}
    assert sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": safety_data}).ok
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 30)
    assert pics.pixit.profile == "dcp-2.0"
    assert pics.pixit.node_id == "02:00:00:00:00:01"
    assert pics.pixit.beacon_period_ms == 50
    assert (pics.pics.vardis, pics.pics.jitter) == (True, True)
    assert pics.pics.several_containers is None
    assert pics.pics.runtime_parameters is None
    assert pics.sut == Pics().sut
    assert "there is no upper tester: claims about services remain undecided" in remarks
    assert any(each.startswith("pixit.profile: a guess from ") for each in remarks)
    # The network identifier is in the beacons of this profile only.
    if codec("dcp-2.0").profile.has_header_field("networkId"):
        assert pics.pixit.network_id is not None


def test_a_silent_node_is_asked():
    sut = node("dcp-2.0", beacon_period_ms=100)
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 20)
    assert any("it was silent, and has been asked" in each for each in remarks)
    assert pics.pixit.node_id == "02:00:00:00:00:01"
    assert pics.pixit.beacon_period_ms == 100
    assert pics.pics.vardis is True


class Silent(VirtualLowerTester):
    """A link on which the tester must not send."""

    def send(self, octets: bytes, source: bytes) -> bytes:
        raise AssertionError("something was sent")


def test_nothing_is_sent_without_permission():
    pics, remarks = draft(Silent(node("dcp-2.0")), None, CANDIDATES, 5, ask=False)
    assert pics == Pics()
    assert remarks[-1].startswith("nothing was heard on in process in 5 s: is the implementation running")


def test_silence():
    sut = node("dcp-2.0")
    # A node that cannot understand what it is asked.
    pics, remarks = draft(sut.lower_tester(), None, [codec("sim-1.0")], 5)
    assert pics == Pics()
    assert any(each.startswith("nothing was heard") for each in remarks)


def test_an_upper_tester_that_names_another_profile():
    sut = node("cpp-1.3")
    busy(sut)
    upper = sut.upper_tester()
    upper.about["profile"] = "sim-2.0"
    pics, remarks = draft(sut.lower_tester(), upper, CANDIDATES, 10)
    assert pics.pixit.profile == "sim-2.0"
    assert any(
        each.startswith("UT-Hello says that the profile is sim-2.0, but its frames look like") for each in remarks
    )


class Air:
    """A lower tester with beacons that were made up."""

    name = "made up"

    def __init__(self, arrivals: list[Arrival]) -> None:
        self._arrivals = arrivals
        self._now = 0

    def now(self) -> int:
        return self._now

    def wall(self) -> int:
        return self._now

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Return a frame to another station: no node answers."""
        return b"\xff" * 6 + source + b"\x49\x53" + octets

    def health(self) -> LinkHealth:
        return LinkHealth(0)

    def receive(self, until: int, also: Any = ()) -> Arrival | None:
        if self._arrivals and self._arrivals[0].time < until:
            arrival = self._arrivals.pop(0)
            self._now = max(self._now, arrival.time)
            return arrival
        self._now = max(self._now, until)
        return None


def heard_from(sut: InProcess, seconds: float) -> list[Arrival]:
    lower, found = sut.lower_tester(), []
    end = lower.now() + round(seconds * 1e9)
    while (arrival := lower.receive(end)) is not None:
        found.append(arrival)
    return found


def test_several_senders():
    one = node("dcp-2.0")
    other = InProcess(msgspec.structs.replace(reference_config(codec("dcp-2.0")), node_id=b"\x02\0\0\0\0\x02"))
    for each in (one, other):
        busy(each)
    both = sorted(heard_from(one, 5) + heard_from(other, 5))
    pics, remarks = draft(Air(list(both)), None, CANDIDATES, 5)  # type: ignore[arg-type]
    assert pics.pixit.node_id is None
    assert any(each.startswith("several senders were heard: ") and "02:00:00:00:00:02" in each for each in remarks)
    assert any("which of the senders is the implementation?" in each for each in remarks)
    # With its identifier known, it is told from the other one.
    pics, _ = draft(Air(list(both)), one.upper_tester(), CANDIDATES, 5)  # type: ignore[arg-type]
    assert pics.pixit.node_id == "02:00:00:00:00:01"
    assert pics.pics.vardis is True


def test_several_senders_of_one_kind():
    made = codec("dcp-2.0")
    builder = FrameBuilder(made)
    twice = builder.vardis(builder.container(VarSumm(1, 1)), builder.container(VarSumm(2, 1)))
    blocks = [twice, Block(5, b"a"), Block(5, b"b")]
    arrivals = [Arrival(at, at, builder.beacon(b"\x02" * 6, at, blocks, network_id=7), b"", b"") for at in range(20)]
    pics, remarks = draft(Air(arrivals), None, [made], 1)  # type: ignore[arg-type]
    assert (pics.pics.several_containers, pics.pics.multiple_payloads, pics.pics.srp) == (True, True, None)
    assert "pics.several_containers: seen in 20 of 20 beacons" in remarks


def test_garbage_does_not_give_a_profile():
    arrivals = [Arrival(at, at, bytes(range(at, at + 60)), b"", b"\x02" * 6) for at in range(1, 20)]
    pics, remarks = draft(Air(list(arrivals)), None, CANDIDATES, 1)  # type: ignore[arg-type]
    assert pics == Pics(pixit=Testing(profile=UNKNOWN_PROFILE))
    assert any(each.startswith("pixit.profile: none of the profiles explains what was heard") for each in remarks)


class Lying(VirtualUpperTester):
    """An upper tester whose parameters make no sense."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = super().call(method, params)
        if method == "BP-GetParameters":
            wrong = {"BPPAR_BEACON_PERIOD": 0, "BPPAR_NETWORK_ID": -4, "BPPAR_MAXIMUM_PACKET_SIZE": "many"}
            return msgspec.structs.replace(answer, result={"parameters": wrong})
        if method == "SRP-GetParameters":
            return msgspec.structs.replace(answer, result={"parameters": 5})
        return answer


def test_invalid_parameters():
    sut = node("dcp-2.0")
    pics, remarks = draft(sut.lower_tester(), Lying(sut), CANDIDATES, 1)
    # Observed values take precedence over those that the upper tester reports.
    assert pics.pixit.network_id == codec("dcp-2.0").profile.bp.network_id
    assert pics.pixit.max_packet_size is None
    assert any("BPPAR_BEACON_PERIOD = 0, which makes no sense" in each for each in remarks)
    assert any("SRP-GetParameters is answered with" in each for each in remarks)


@pytest.mark.parametrize("profile", profile_names())
def test_guessing_the_profile_of_frames(profile):
    sut = node(profile)
    busy(sut)
    if "SRP-UpdateSafetyData" in sut.upper_tester().methods:
        fields = [each for each in codec(profile).profile.srp.safety_data if each.type != "opaque"]
        data = {each.name: 1 for each in fields}
        sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": data})
    heard = heard_from(sut, 5)
    assert heard
    # Nothing speaks against the right one.
    assert not doubtful(ranked_with(codec(profile), ((each.wall, each.octets) for each in heard)), profile)


def test_a_draft_without_a_profile_is_not_run(tmp_path):
    path = tmp_path / "draft.toml"
    write_pics(Pics(pixit=Testing(profile=UNKNOWN_PROFILE)), path, ["pixit.profile: none explains it"])
    with pytest.raises(UsageError, match=r"draft.toml: pixit.profile: probe could not determine .* give --profile"):
        describe(TargetOptions(pics=path))
    assert describe(TargetOptions(pics=path, profile="dcp-1.3"))[0].profile.name == "dcp-1.3"


@pytest.mark.parametrize("asked_for", ["dcp-2.0", "cpp-2.0"])
def test_a_tie_goes_to_the_profile_that_was_asked_for(asked_for):
    # Only summaries: nothing in which the two differ.
    builder = FrameBuilder(codec("dcp-2.0"))
    blocks = [builder.vardis(builder.container(VarSumm(1, 1)))]
    arrivals = [Arrival(at, at, builder.beacon(b"\x02" * 6, at, blocks), b"", b"") for at in range(20)]
    pics, remarks = draft(Air(arrivals), None, CANDIDATES, 1, asked_for=asked_for)  # type: ignore[arg-type]
    assert pics.pixit.profile == asked_for
    (remark,) = [each for each in remarks if each.startswith("pixit.profile: ")]
    other = {"dcp-2.0": "cpp-2.0", "cpp-2.0": "dcp-2.0"}[asked_for]
    assert f"{other} would explain them as well: is {asked_for} right?" in remark


def test_a_wrong_requested_profile_is_reported():
    sut = node("cpp-1.3")
    busy(sut)
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 10, asked_for="dcp-2.0")
    assert pics.pixit.profile == "cpp-1.3"
    assert any("dcp-2.0 explains them less well" in each for each in remarks)


def with_mutant(identifier: str, profile: str = "dcp-2.0") -> InProcess:
    return InProcess(reference_config(codec(profile)), make=all_mutants()[identifier].make)


def test_one_bad_block_does_not_hide_what_the_others_say():
    sut = with_mutant("M-SRP-FMT-01-test-pattern", "dcp-1.2")
    busy(sut)
    for number in range(40):
        assert sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": {"x": number, "y": 2, "z": 3}}).ok
        sut.elapse(100_000_000)
    pics, remarks = draft(sut.lower_tester(), None, WITHOUT_PATTERN, 10, asked_for="dcp-1.2")
    assert pics.pixit.profile == "dcp-1.2"
    assert (pics.pixit.node_id, pics.pixit.beacon_period_ms) == ("02:00:00:00:00:01", 100)
    assert (pics.pics.srp, pics.pics.vardis) == (True, True)
    assert any("cannot be read to their end: SRP-FMT-01: a payload of fixed size" in each for each in remarks)


def test_a_pattern_of_a_profile_is_not_a_state_report():
    sut = with_mutant("M-SRP-FMT-01-test-pattern", "cpp-1.3")
    busy(sut)
    for number in range(40):
        assert sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": {"x": number, "y": 2, "z": 3}}).ok
        sut.elapse(100_000_000)
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 10)
    assert pics.pixit.profile == "cpp-1.2"
    assert pics.pics.srp is not True
    assert pics.pics.vardis is True
    assert not any("SRP-FMT-01" in each for each in remarks)


@pytest.mark.parametrize(
    ("identifier", "told"),
    [
        ("M-BP-HDR-02-swapped", "BP-HDR-02: 0x7e49: its octets are swapped"),
        ("M-BP-HDR-06-with-header", "BP-HDR-06: "),
        ("M-BP-FMT-01-block-with-header", "BP-FMT-01: "),
        ("M-DATA-01-all-swapped", "DATA-01: integers with their least significant octet first"),  # prose: data
    ],
)
def test_a_fault_in_the_header_is_reported_and_the_profile_found(identifier, told):
    sut = with_mutant(identifier)
    busy(sut)
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 10)
    assert pics.pixit.profile == "dcp-2.0"
    assert any("cannot be read to their end" in each and told in each for each in remarks)


@pytest.mark.parametrize(
    ("profile", "told"),
    [
        *also(
            "suite",
            ("dcp-2.0", True),
            *((each, number % 2 == 1) for number, each in enumerate(PROFILES) if each != "dcp-2.0"),
        ),
        *also("suite", ("dcp-2.0", False)),
    ],
)
def test_a_draft_never_makes_a_conforming_node_fail(profile, told, tmp_path):
    sut = node(profile)
    if told:
        busy(sut)
    upper = sut.upper_tester() if told else None
    path = tmp_path / "draft.toml"
    drafted, remarks = draft(sut.lower_tester(), upper, CANDIDATES, 20, asked_for=profile)
    write_pics(drafted, path, remarks)
    pics = load_pics(path)
    assert pics.pixit.profile == profile
    # The profile denies some capabilities where the PICS is silent; the draft denies no more.
    assert denied_by(pics.pics, codec(profile).profile) == denied_by(Capabilities(), codec(profile).profile)
    fresh = node(profile)
    session = Session(codec(pics.pixit.profile), fresh.lower_tester(), fresh.upper_tester(), pics)
    runner = Runner(session, fresh)
    runner.prepare()
    cases = every_case()
    # Profiles take turns with the cases: the part of the core runs all of them, each other one a quarter.
    for case in cases if (profile, told) == ("dcp-2.0", True) else cases[PROFILES.index(profile) % 4 :: 4]:
        result = runner.run(case)
        wrong = result.verdict in (Verdict.FAIL, Verdict.ERROR, Verdict.INCONCLUSIVE)
        assert not wrong or case.id in (DECLARED, DENIED), (case.id, result.reason)


def test_another_profile_is_doubted():
    sut = node("cpp-1.3")
    busy(sut)
    ranked = ranked_with(codec("dcp-2.0"), ((each.wall, each.octets) for each in heard_from(sut, 5)))
    assert doubtful(ranked, "dcp-2.0")
    assert ranked.best.profile.name == "cpp-1.3"


def beacons_at(times: list[float], seqnos: list[int]) -> list[tuple[Arrival, Any]]:
    return [
        (Arrival(round(at * 1e6), 0, b"", b"", b""), Beacon(BPHeader(b"\x02" * 6, seqno, None), ()))
        for at, seqno in zip(times, seqnos, strict=True)
    ]


def test_measuring_a_period():
    assert measured_period([]) is None
    assert measured_period(beacons_at([100.0 * n for n in range(10)], list(range(10)))) is None
    steady = measured_period(beacons_at([100.0 * n for n in range(21)], list(range(21))))
    assert steady is not None
    assert (steady.mean, steady.deviation, steady.intervals) == (100, 0, 20)
    # Every other beacon was not heard.
    lost = measured_period(beacons_at([100.0 * n for n in range(0, 40, 2)], list(range(0, 40, 2))))
    assert lost is not None
    assert lost.mean == 100
    # A pause is not an interval, and a new start of the sequence numbers is none either.
    times = [100.0 * n for n in range(12)] + [5000 + 100.0 * n for n in range(12)]
    paused = measured_period(beacons_at(times, list(range(24))))
    assert paused is not None
    assert (paused.mean, paused.intervals) == (100, 22)
    restarted = measured_period(beacons_at(times, [*range(12), *range(12)]))
    assert restarted is not None
    assert restarted.mean == 100


@pytest.mark.parametrize(
    ("mean", "deviation", "result"),
    [
        (100.4, 5, 100),
        (103, 5, 103),
        (98.6, 9, 100),
        (51.2, 7, 50),
        (33.33, 0.01, 33),
        (0.4, 0.001, 0.4),
        (249, 8, 250),
    ],
)
def test_rounding(mean, deviation, result):
    assert rounded(Period(mean, deviation, 100)) == result


def test_every_key_has_a_question_or_a_value():
    text = pics_text(Pics())
    tables = msgspec.structs.asdict(Pics())
    # Readings are keys of their own, for which the table has no line before they are declared.
    assert tables.pop("readings") == {}
    keys = {f"{table}.{name}" for table, part in tables.items() for name in part.__struct_fields__}
    assert keys == set(QUESTIONS)
    for key in keys:
        assert f"# {QUESTIONS[key]}\n# {key.split('.')[1]} =" in text
    assert tomllib.loads(text) == {"sut": {}, "access": {}, "pics": {}, "readings": {}, "pixit": {}}


def test_a_written_file_reads_back(tmp_path, capsys):
    sut = node("cpp-2.0")
    busy(sut)
    pics, remarks = draft(sut.lower_tester(), sut.upper_tester(), CANDIDATES, 10)
    pics = msgspec.structs.replace(
        pics,
        sut=msgspec.structs.replace(pics.sut, notes='a "quoted"\nline \x7f\\ é'),
        pixit=msgspec.structs.replace(pics.pixit, var_ids=(3, 9)),
    )
    remarks = [*remarks, "something\nelse = 5"]
    path = tmp_path / "pics.toml"
    write_pics(pics, path, remarks)
    assert load_pics(path) == pics
    text = path.read_text()
    assert '# as UT-Hello says\nname = "dcp-node"\n' in text
    assert "# Note: something else = 5\n" in text
    with pytest.raises(UsageError, match="exists already"):
        write_pics(pics, path)
    with pytest.raises(UsageError, match="cannot be written: No such file"):
        write_pics(pics, tmp_path / "nowhere" / "pics.toml")
    write_pics(pics, None, remarks)
    assert capsys.readouterr().out == text


@pytest.mark.parametrize(("check_ms", "periods"), [(50, "4.0"), (400, "8.5")])
def test_the_reaction_time_is_measured(check_ms: int, periods: str):
    config = msgspec.structs.replace(
        reference_config(codec("dcp-2.0")), vardis=VardisConfig(buffer_check_period_ms=check_ms)
    )
    sut = InProcess(config)
    busy(sut)
    pics, remarks = draft(sut.lower_tester(), sut.upper_tester(), CANDIDATES, 5)
    assert any(each.startswith(f"reactions are waited for {periods} beacon periods (slowest of 5") for each in remarks)
    # Each run measures it: a number in the file would count as stated by the user.
    assert pics.pixit.reaction_periods is None


def silent_but_for_a_pattern(**options):
    """A node that sends a test pattern in place of state reports in every beacon, and has no variables."""
    sut = with_mutant("M-SRP-FMT-01-test-pattern", "dcp-1.2")
    for number in range(40):
        assert sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": {"x": number, "y": 2, "z": 3}}).ok
        sut.elapse(100_000_000)
    return draft(sut.lower_tester(), None, WITHOUT_PATTERN, 10, **options)


@pytest.mark.parametrize("asked_for", [None, "dcp-1.2", "dcp-2.0"])
def test_a_node_with_only_unreadable_blocks_is_identified_by_its_headers(asked_for):
    pics, remarks = silent_but_for_a_pattern(ask=False, asked_for=asked_for)
    assert pics.pixit.profile in ("dcp-1.2", "dcp-1.3", "cpp-1.3")
    assert asked_for != "dcp-1.2" or pics.pixit.profile == asked_for
    assert (pics.pixit.node_id, pics.pixit.beacon_period_ms) == ("02:00:00:00:00:01", 100)
    assert pics.pics.srp is True
    (profile,) = [each for each in remarks if each.startswith("pixit.profile: ")]
    assert "headers and block lists of" in profile
    assert "0 of" in profile
    assert "for SRP can be read" in profile
    assert "none is for VarDis" in profile
    assert "which one is it?" in profile
    assert "asked for" not in profile


def test_a_node_that_sends_no_variables_is_asked_for_some():
    pics, remarks = silent_but_for_a_pattern()
    assert pics.pixit.profile in ("cpp-1.3", "dcp-1.2", "dcp-1.3")
    assert pics.pics.vardis is True
    assert any("no VarDis payload was heard, and it has been asked" in each for each in remarks)
    assert any("0 of" in each and "for SRP can be read" in each for each in remarks)


def test_the_default_profile_is_not_called_requested():
    sut = with_mutant("M-BP-HDR-02-swapped")
    busy(sut)
    _, remarks = draft(sut.lower_tester(), None, CANDIDATES, 10)
    (profile,) = [each for each in remarks if each.startswith("pixit.profile: ")]
    assert "asked for" not in profile
