"""Recordings as tests: an implementation takes the part of a recorded node."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from dcp_conformance.check.recording import guessed_profile
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.replay import RecordedNodes, Replay, choose_node, decided, recorded_nodes
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.reporting import load_results
from dcp_conformance.test_system.bench import Session
from dcp_selftest.mutants import all_mutants

from dcp_codec.capture import Frame, create_capture
from dcp_codec.values import VarSumm, VarUpdate

from ...parts import also
from ..air import Script, simulated
from ..command import Command
from ..rig import codec_of

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
GOLDENS = sorted(path.stem for path in CAPTURES.glob("*.mcap"))
NODES = ("02:00:00:00:00:01", "02:00:00:00:00:02", "02:00:00:00:00:03")


def octets(node: str) -> bytes:
    return bytes.fromhex(node.replace(":", ""))


def replayed(
    path: Path,
    node: str | None,
    *,
    called: str | None = None,
    make: MakeNode = plain_node,
    upper: bool = True,
    speed: float = 1.0,
    services: bool = True,
) -> CaseResult:
    """Play a recording to our node, whose identifier is ``called``, by default that of the node it replaces."""
    codec = codec_of(guessed_profile(path))
    name = octets(called or node or NODES[0])
    sut = InProcess(reference_config(codec, node_id=name), make=make)
    session = Session(codec, sut.lower_tester(), sut.upper_tester() if upper else None, Pics())
    runner = Runner(session, sut)
    runner.prepare()
    replay = Replay(path, octets(node) if node else None, speed=speed, services=services)
    (case,) = replay.cases()
    return decided(runner.run(case))


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("name", ["b_crud", *also("suite", *(each for each in GOLDENS if each != "b_crud"))])
class TestGoldens:
    def test_our_node_replaces_each_recorded_node(self, name: str, node: str):
        result = replayed(CAPTURES / f"{name}.mcap", node)
        assert result.verdict is Verdict.PASS, result.reason
        assert {"VD-CMP-04", "VD-PC-09", "VD-PU-07"} <= set(result.requirements)
        assert result.evidence

    @pytest.mark.parametrize("speed", [0, 4])
    def test_playing_faster_than_recorded(self, name: str, node: str, speed: float):
        result = replayed(CAPTURES / f"{name}.mcap", node, speed=speed)
        assert result.verdict is Verdict.PASS, result.reason

    def test_without_an_upper_tester(self, name: str, node: str):
        result = replayed(CAPTURES / f"{name}.mcap", node, upper=False)
        assert result.verdict is Verdict.PASS, result.reason
        assert "VD-UPD-08" not in result.requirements


class TestWhatIsFound:
    @pytest.mark.part("suite")
    @pytest.mark.parametrize(
        ("mutant", "named"),
        [
            ("M-VD-PU-07-ignored", "VD-CMP-04"),
            *also(
                "suite",
                ("M-VD-RC-03-consumer-silent", "VD-RC-03"),
                ("M-VD-PU-05-repeated", "VD-SCP-02"),
                ("M-VD-PS-04-not-requested", "VD-PS-04"),
            ),
        ],
    )
    def test_a_wrong_node_fails(self, mutant: str, named: str):
        """In some recording: not every one gives an occasion for every fault."""
        make = all_mutants()[mutant].make
        results = (replayed(CAPTURES / f"{name}.mcap", node, make=make) for name in GOLDENS for node in NODES[:2])
        assert any(
            named in check.requirements
            for result in results
            if result.verdict is Verdict.FAIL
            for check in result.checks
            if check.verdict is Verdict.FAIL
        )

    def test_a_node_that_changes_forwarded_values_fails(self):
        def reversed_values(octets: bytes) -> bytes:
            beacon = codec.decode(octets)
            payloads = []
            for payload in beacon.payloads:
                content = tuple(
                    msgspec.structs.replace(
                        each,
                        records=tuple(
                            msgspec.structs.replace(record, value=record.value[::-1])
                            if isinstance(record, VarUpdate)
                            else record
                            for record in each.records
                        ),
                    )
                    for each in payload.vardis or ()
                )
                payloads.append(msgspec.structs.replace(payload, content=content) if payload.vardis else payload)
            return codec.encode(msgspec.structs.replace(beacon, payloads=tuple(payloads)))

        class Forgetful(InProcess):
            def carry_out(self) -> None:
                before = len(self.arrivals)
                super().carry_out()
                for place in range(before, len(self.arrivals)):
                    arrival = self.arrivals[place]
                    self.arrivals[place] = arrival._replace(octets=reversed_values(arrival.octets))

        path = CAPTURES / "b_crud.mcap"
        codec = codec_of(guessed_profile(path))
        sut = Forgetful(reference_config(codec, node_id=octets(NODES[2])))
        session = Session(codec, sut.lower_tester(), sut.upper_tester(), Pics())
        runner = Runner(session, sut)
        runner.prepare()
        result = runner.run(Replay(path, octets(NODES[2])).cases()[0])
        assert result.verdict is Verdict.FAIL

    def test_a_silent_node_does_not_pass(self):
        class Mute(InProcess):
            def carry_out(self) -> None:
                super().carry_out()
                self.arrivals.clear()

        path = CAPTURES / "c_latejoin.mcap"
        codec = codec_of("cpp-2.0")
        sut = Mute(reference_config(codec, node_id=octets(NODES[2])))
        session = Session(codec, sut.lower_tester(), None, Pics())
        session.sut_id = octets(NODES[2])
        result = Runner(session, sut).run(Replay(path).cases()[0])
        assert result.verdict is Verdict.FAIL

    def test_a_recording_decides_only_requirements_that_it_exercises(self, tmp_path: Path):
        air = Script()
        for _ in range(20):
            air.say(1, *([air.create(7, 1)] if not air.frames else []), VarSumm(7, 0))
            air.say(2, VarSumm(7, 0))
        path = tmp_path / "create.mcap"
        with create_capture(path) as writer:
            for frame in air.frames:
                writer.write(frame)
        result = replayed(path, NODES[1], called="02:00:00:00:00:77", services=False)
        assert result.verdict is Verdict.PASS, result.reason
        assert {"VD-PC-09", "VD-PC-10", "VD-SCP-02"} <= set(result.requirements)
        assert not {"VD-PD-04", "VD-RC-03", "VD-RU-04", "VD-PS-04", "VD-UPD-08"} & set(result.requirements)

    def test_malformed_frames_are_played_and_make_results_inconclusive(self, tmp_path: Path):
        frames = simulated("dcp-2.0", 4, seconds=10)
        path = tmp_path / "broken.mcap"
        with create_capture(path) as writer:
            for frame in frames:
                data = frame.data[:-3] if frame.number % 9 == 0 else frame.data
                writer.write(_with(frame, data))
        result = replayed(path, "02:00:00:00:00:00")
        assert result.verdict is Verdict.PASS, result.reason


def _with(frame: Frame, data: bytes) -> Frame:
    return msgspec.structs.replace(frame, data=data, orig_len=len(data))


class TestParts:
    def test_the_node_itself_is_replaced_if_recorded_else_the_one_that_produces_least(self):
        path = CAPTURES / "b_crud.mcap"
        cast = recorded_nodes(path, codec_of("cpp-2.0"))
        assert sorted(each.hex(":") for each in cast.beacons) == list(NODES)
        assert choose_node(cast, octets(NODES[1])) == octets(NODES[1])
        assert choose_node(cast, None) == octets(NODES[2])
        assert choose_node(cast, b"\x02\0\0\0\0\x99") == octets(NODES[2])
        assert isinstance(cast, RecordedNodes)

    def test_the_node_may_have_an_unrecorded_identifier(self):
        result = replayed(CAPTURES / "c_latejoin.mcap", NODES[2], called="02:00:00:00:00:77")
        assert result.verdict is Verdict.PASS, result.reason

    def test_an_unknown_node_identifier_is_learned_from_beacons_first(self):
        path, codec = CAPTURES / "b_crud.mcap", codec_of("cpp-2.0")
        sut = InProcess(reference_config(codec, node_id=b"\x02\0\0\0\0\x77"))
        session = Session(codec, sut.lower_tester(), None, Pics())
        result = Runner(session, sut).run(Replay(path).cases()[0])
        assert session.sut_id == b"\x02\0\0\0\0\x77"
        assert result.verdict is Verdict.PASS, result.reason

    def test_the_identifier_of_another_recorded_node_is_refused(self):
        replay = Replay(CAPTURES / "b_crud.mcap", octets(NODES[0]))
        with pytest.raises(UsageError, match=r"has the identifier 02:00:00:00:00:02 of another recorded node"):
            replay.take_part(codec_of("cpp-2.0"), octets(NODES[1]))


class TestCommand:
    def test_it_passes_and_writes_a_report(self, dcp_conformance: Command, tmp_path: Path):
        path = CAPTURES / "b_crud.mcap"
        done = dcp_conformance("replay", path, "--in-process", "--node", NODES[0], "--report-dir", tmp_path)
        assert done.status == 0, done.err
        assert "cpp-2.0" in done.out
        run = load_results(tmp_path)
        assert run.kind == "replay"
        assert [case.verdict for case in run.cases] == [Verdict.PASS]
        assert (tmp_path / "report.html").exists()
        assert set(run.requirements.values()) == {Verdict.PASS}

    def test_the_replaced_node_is_reported(self, dcp_conformance: Command):
        done = dcp_conformance("replay", CAPTURES / "b_crud.mcap", "--in-process")
        assert f"note: it took the part of {NODES[2]} of the recording" in done.out
        assert done.err == ""

    @pytest.mark.parametrize(("speed", "told"), [("100000", "the replay takes 1 h 0 min; --speed 0"), ("0", "")])
    def test_long_pauses_are_announced(self, dcp_conformance: Command, tmp_path: Path, speed: str, told: str):
        path = tmp_path / "paused.pcap"
        frames = simulated("dcp-2.0", 3, seconds=4)
        with create_capture(path) as writer:
            for number, frame in enumerate(frames):
                late = 100_000 * 3600 if number >= len(frames) - 5 else 0
                writer.write(msgspec.structs.replace(frame, time_ns=frame.time_ns + late * 10**9))
        done = dcp_conformance("replay", path, "--in-process", "--speed", speed)
        assert told in done.err
        assert ("the replay takes" in done.err) == bool(told)

    @pytest.mark.parametrize("options", [["--speed", "0"], ["--speed", "4"], ["--no-services"], []])
    def test_its_options(self, dcp_conformance: Command, options: list[str]):
        done = dcp_conformance("replay", CAPTURES / "c_latejoin.mcap", "--in-process", *options)
        assert done.status == 0, done.out

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["no-such.mcap"], "no-such.mcap"),
            ([__file__], "test_replay.py"),
            ([CAPTURES / "b_crud.mcap", "--node", "02:00:00:00:00:09"], "no node 02:00:00:00:00:09 in it; there are"),
            ([CAPTURES / "b_crud.mcap", "--node", "drone"], "'drone' is not a node identifier"),
            ([CAPTURES / "b_crud.mcap", "--profile", "dcp-9"], "dcp-9"),
            ([CAPTURES / "b_crud.mcap", "--speed", "-1"], "--speed"),
        ],
    )
    def test_recordings_that_cannot_be_played_are_refused(
        self, dcp_conformance: Command, arguments: list[object], message: str
    ):
        done = dcp_conformance("replay", *arguments, "--in-process")
        assert done.status == 2
        assert message in done.err

    def test_a_recording_without_the_profile_is_refused(self, dcp_conformance: Command, tmp_path: Path):
        path = tmp_path / "other.pcap"
        with create_capture(path) as writer:
            for frame in simulated("dcp-2.0", 3, seconds=4)[:5]:
                data = frame.data[:12] + b"\x08\x00" + frame.data[14:]
                writer.write(_with(frame, data))
        done = dcp_conformance("replay", path, "--in-process", "--profile", "dcp-2.0")
        assert done.status == 2
        assert "none of its 5 frames is DCP" in done.err
