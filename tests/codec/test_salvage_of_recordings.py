"""Recordings of an implementation that sends one unreadable block in every beacon: the others count all the same."""

from __future__ import annotations

from dcp_spec.profile.loading import profile_names

from dcp_codec import Beacon, BPHeader, Container, Payload, VarSumm, get_codec
from dcp_codec.analysis.guess import guess
from dcp_codec.analysis.stats import Stats
from dcp_codec.capture import Frame
from dcp_codec.framing.envelope import Envelope
from dcp_codec.framing.locate import locate

SENDER = bytes.fromhex("020000000001")
PATTERN = bytes(range(0x20, 0x20 + 40))
#: A profile with the layout of that release but for the state report, of which it expects 42 octets.
CODEC = get_codec("dcp-1.2")
#: Without the profile that knows the pattern: unknown implementations send other patterns.
OTHERS = [name for name in profile_names() if name != "cpp-1.2"]


def recording(count: int = 30, *, reports: int = 1) -> list[Frame]:
    """Beacons as release 1.2.0 sends them: a test pattern in place of the report, then summaries."""
    frames = []
    for number in range(count):
        payloads = [Payload(2, CODEC.encode_containers((Container(1, (VarSumm(7, number % 256),)),)))]
        if number % 10 != 9:
            payloads[:0] = [Payload(1, PATTERN)] * reports
        octets = CODEC.encode_envelope(Beacon(BPHeader(SENDER, number), tuple(payloads)))
        data = Envelope(CODEC.profile.link).frame(octets.ljust(46, b"\0"), SENDER)
        frames.append(Frame(number + 1, 1_750_000_000_000_000_000 + number * 100_000_000, data, len(data)))
    return frames


def test_beacons_with_a_bad_block_are_beacons() -> None:
    stats = Stats(CODEC)
    for frame in recording():
        stats.add(frame, locate(frame.data, CODEC.profile.link))
    told = stats.as_json()
    assert (told["beacons"], told["errors"], told["srp"], told["vardis"]) == (30, 27, 27, 30)
    assert told["records"] == {"SUMMARIES": 30}
    assert told["error_reasons"] == {"wrong-length": 27}
    assert told["senders"]["02:00:00:00:00:01"]["lost"] == 0
    # Only the beacons without the pattern are short enough to be padded.
    assert told["padded"] == 3
    assert told["octets"] == sum((16 + 4 + 4) + (44 if number % 10 != 9 else 0) for number in range(30))


#: A bearer payload of release 1.2.0, as recorded: SRP's test pattern, then two summaries.
RECORDED = bytes.fromhex(
    "01497e020000000001003602 0000000d 00010028 202122232425262728292a2b2c2d2e2f303132333435363738393a3b3c3d3e3f"
    "4041424344454647 00020006 010201000200"
)


def test_a_recorded_beacon_of_the_release() -> None:
    found = CODEC.salvage(RECORDED)
    assert found.clear
    assert found.beacon is not None
    assert found.beacon.bp is not None
    assert (found.beacon.bp.sender_id, found.beacon.bp.seqno) == (SENDER, 13)
    assert found.beacon.payloads[1].vardis == (Container(1, (VarSumm(1, 0), VarSumm(2, 0))),)
    assert found.octets_of(0) == PATTERN
    (problem,) = found.problems
    assert (problem.reason, problem.needed, problem.available) == ("wrong-length", 42, 40)


def test_profiles_with_the_same_layout_of_other_blocks_are_tied() -> None:
    found = guess(recording(), profiles=OTHERS)
    names = {found.best.profile.name, *(each.profile.name for each in found.tied)}
    assert names == {"dcp-1.2", "dcp-1.3", "cpp-1.3"}
    assert (found.best.decoded, found.best.in_part) == (3, 27)
    assert found.best.explained == 1.0
    assert found.best.score > 0.25
    assert all(each.score < 0.1 and each.explained == 0 for each in found.candidates if each.profile.name not in names)
    assert "one of several: 3 of 30 sampled frames decode, 27 more in part" in str(found)
    assert not found.certain


def test_a_full_decoding_beats_a_partial_one() -> None:
    scores = [guess(recording(reports=reports), profiles=OTHERS).best.score for reports in (0, 1, 3)]
    assert scores[0] == 1.0
    assert scores == sorted(scores, reverse=True)
    assert len(set(scores)) == 3


def test_the_profile_of_the_release_reads_the_pattern() -> None:
    found = guess(recording())
    assert (found.best.profile.name, found.best.decoded, found.tied) == ("cpp-1.2", 30, ())
    assert found.certain
    stats = Stats(get_codec("cpp-1.2"))
    for frame in recording():
        stats.add(frame, locate(frame.data, CODEC.profile.link))
    told = stats.as_json()
    assert (told["beacons"], told["errors"], told["srp"], told["vardis"]) == (30, 0, 27, 30)
