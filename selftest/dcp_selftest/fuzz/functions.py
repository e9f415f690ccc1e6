"""Fuzz functions in this process: the codec, the capture readers, the control interface, the file loaders."""

from __future__ import annotations

import contextlib
import io
import logging
import random
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec
from dcp_conformance.definitions.pics import load_pics
from dcp_conformance.errors import UsageError
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_lab.fuzz.execute.time_limit import TIME_LIMIT, TimeLimit, TimeLimitExceeded
from dcp_lab.fuzz.steps import Effect, EffectKind, Frame, Step
from dcp_lab.testing.mutation import Mutator
from dcp_spec.profile.loading import ProfileError, load_profile, profile_names

from dcp_codec.capture import CaptureError, create_capture, open_capture
from dcp_codec.capture import Frame as Captured
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_selftest.fuzz.havoc import Havoc

PARTS: Final = ("beacon", "capture", "control", "profile", "pics")
"""The parts that can be fuzzed in process, besides the stack."""
#: Relative frequency of each part; a test of a beacon takes a hundredth of the time of a file.
_SHARES: Final = (60, 10, 20, 2, 8)
#: Requests to the control interface, from which mutation makes others.
_LINES: Final = (
    b'{"jsonrpc":"2.0","id":1,"method":"UT-Hello","params":{}}\n',
    b'{"jsonrpc":"2.0","id":2,"method":"RTDB-Create","params":{"varId":1,"repCnt":1,"descr":"x","value":"00"}}\n',
    b'{"jsonrpc":"2.0","id":3,"method":"RTDB-Update","params":{"varId":1,"value":"0102"}}\n',
    b'{"jsonrpc":"2.0","id":4,"method":"RTDB-Read","params":{"varId":1}}\n'
    b'{"jsonrpc":"2.0","id":5,"method":"UT-Status"}\n',
    b'{"jsonrpc":"2.0","id":6,"method":"SRP-UpdateSafetyData","params":{"sData":{"x":1.0,"y":2.0,"z":3.0}}}\n',
    b'{"jsonrpc":"2.0","id":7,"method":"BP-RegisterProtocol","params":{"protId":9,"name":"n","maxPayloadSize":10,'
    b'"queueMode":"BP-QMODE-ONCE","maxEntries":1,"multiple":false}}\n',
    b'{"jsonrpc":"2.0","id":8,"method":"BP-SetParameter","params":{"name":"BPPAR_BEACON_PERIOD","value":50}}\n',
    b'[{"jsonrpc":"2.0","id":9,"method":"RTDB-DescribeDatabase"},{"jsonrpc":"2.0","method":"UT-Reset"}]\n',
    b'{"jsonrpc":"2.0","id":10,"method":"UT-Subscribe","params":{"variables":true,"neighbours":true}}\n',
)
_JSON_WORDS: Final = (
    b"null", b"true", b"[]", b"{}", b"1e999", b"-1", b"1.5", b"18446744073709551616", b'"\\ud800"', b'""', b"\n",
    b"[[[[", b'"method":', b'"params":', b'"id":', b'"varId":', b"NaN", b"-0", b"\xc3\x28",
)  # fmt: skip
_TOML_WORDS: Final = (
    b"\n", b"=", b"[", b"]", b"{", b"}", b'"', b"true", b"nan", b"-1", b"0", b"65536", b"[]", b"\xff", b"{ width = 0 }",
    b"{ opaque = 1, name = \"x\" }", b"extends = \"dcp-2.0\"\n", b"1979-05-27", b"9223372036854775808", b"'''",
)  # fmt: skip
_PICS: Final = (
    b'[sut]\nname = "x"\n[pics]\nsrp = true\nmultiple_payloads = false\n[pixit]\nprofile = "dcp-2.0"\n'
    b'beacon_period_ms = 50\nvar_ids = [0, 10]\nreset = "none"\n',
)


class FunctionTarget:
    """Calls functions with octets. Each step is the input of one part; the note of the frame names the part."""

    name = "functions in this process"

    def __init__(self, codec: Codec, *, time_limit: float = TIME_LIMIT) -> None:
        """``time_limit``: maximum CPU time of one call in seconds."""
        self.codec = codec
        self._limit = TimeLimit(time_limit)
        self._parts: dict[str, Callable[[bytes], str]] = {
            "beacon": self._beacon,
            "capture": self._capture,
            "control": self._control,
            "profile": self._profile,
            "pics": self._pics,
        }
        self._folder = tempfile.TemporaryDirectory(prefix="dcp-fuzz-")
        self._file = Path(self._folder.name) / "input.toml"
        self._sut: InProcess | None = None
        # The server would log each refused request.
        logging.getLogger("dcp_stack.control.server").setLevel(logging.CRITICAL)

    def close(self) -> None:
        """Remove the temporary folder."""
        self._folder.cleanup()

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_lab.fuzz.steps.Target`."""
        self._sut = None
        for at, step in enumerate(steps):
            if isinstance(step, Frame) and (effect := self.once(step.note or "beacon", step.octets, at)) is not None:
                return effect
        return None

    def once(self, part: str, octets: bytes, at: int = 0) -> Effect | None:
        """Call one part with these octets. Returns the effect, or None."""
        function = self._parts[part]
        try:
            with self._limit:
                wrong = function(octets)
        except TimeLimitExceeded:
            return Effect("hang", f"{part}: no end after {self._limit.seconds:g} s of CPU time", at, part)
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{part}: {type(error).__name__} in {last.name}"
            return Effect("raised", f"{part}: {type(error).__name__}: {error}", at, place)
        kind: EffectKind = "disagrees"
        return Effect(kind, f"{part}: {wrong}", at, f"{part}: {wrong.partition(':')[0]}") if wrong else None

    # -- parts: each returns a description of the fault, or an empty string ------------------------------------

    def _beacon(self, octets: bytes) -> str:
        """Check that dissector and decoder agree, and that encoding is the reverse of decoding."""
        codec = self.codec
        found = codec.dissect(octets)
        first = next((problem for problem in found.problems if problem.severity == "error"), None)
        try:
            beacon, end = codec.decode_from(octets)
        except DecodeError as error:
            if error.problem != first:
                return f"decoder and dissector disagree: {error.problem} and {first}"
            return ""
        if first is not None:
            return f"the decoder takes what the dissector does not: {first}"
        again = codec.encode(beacon)
        if again != octets[:end]:
            # A value with several encodings must at least stay the same. repr() is compared because NaN != NaN.
            try:
                same = repr(codec.decode(again)) == repr(beacon)
            except DecodeError:
                same = False
            if not same:
                return f"encoding is not the reverse of decoding: {again.hex()}"
        return ""

    def _capture(self, octets: bytes) -> str:
        """Check that reading a capture ends with frames, problems or a CaptureError."""
        with contextlib.suppress(CaptureError), open_capture(io.BytesIO(octets)) as reader:
            for frame in reader:
                if len(frame.data) > frame.orig_len:
                    return "a frame is longer than it was"
        return ""

    def _control(self, octets: bytes) -> str:
        """Check that the control interface answers requests, and serves the next client."""
        if self._sut is None:
            self._sut = InProcess(reference_config(self.codec))
        sut = self._sut
        session = sut.server.open()
        answers = session.feed(octets + b"\n", now=sut.now, wall=sut.wall())
        sut.carry_out()
        session.feed(b"", now=sut.now, wall=sut.wall())
        sut.server.forget(session)
        if b'"code":-32603' in answers:
            return f"internal error: {answers[:300].decode('utf-8', 'replace')}"
        for line in answers.splitlines():
            msgspec.json.decode(line)
        other = sut.server.open()
        answer = other.feed(_LINES[0], now=sut.now, wall=sut.wall())
        sut.server.forget(other)
        sut.advance(sut.now + 100_000_000)
        sut.arrivals.clear()
        if sut.died:
            self._sut = None
            raise RuntimeError(f"the node crashed on a request: {sut.died}")
        return "" if b'"result"' in answer else "the next client gets no answer"

    def _profile(self, octets: bytes) -> str:
        """Check that a profile is loaded and has a codec, or is rejected with a ProfileError."""
        self._file.write_bytes(octets)
        with contextlib.suppress(ProfileError):
            profile = load_profile(self._file)
            codec = Codec(profile)
            codec.dissect(b"\x01" * 60)
            with contextlib.suppress(DecodeError):
                codec.decode(b"\x01" * 60)
        return ""

    def _pics(self, octets: bytes) -> str:
        """Check that a PICS file is loaded, or rejected with a UsageError."""
        self._file.write_bytes(octets)
        with contextlib.suppress(UsageError):
            load_pics(self._file)
        return ""


class FunctionInputs:
    """Generator of inputs for :class:`FunctionTarget`."""

    def __init__(self, codec: Codec, rng: random.Random, mutator: Mutator, parts: Sequence[str] = PARTS) -> None:
        self._rng = rng
        self._mutator = mutator
        shares = [(part, share) for part, share in zip(PARTS, _SHARES, strict=True) if part in parts]
        self._parts, self._weights = zip(*shares, strict=True)
        beacons = [source.octets for source in mutator.sources[:6]]
        self._havoc: dict[str, Havoc] = {
            "capture": Havoc(rng, list(_captures(beacons))),
            "control": Havoc(rng, _LINES, _JSON_WORDS),
            "profile": Havoc(rng, list(_profiles()), _TOML_WORDS),
            "pics": Havoc(rng, _PICS, _TOML_WORDS),
        }
        self.kinds: tuple[str, ...] = ()
        """The part of the last input."""
        self._codec = codec

    def seeds(self, part: str) -> list[bytes]:
        """Return the inputs of a part that are mutated."""
        if part == "beacon":
            return [source.octets for source in self._mutator.sources]
        return self._havoc[part].pool

    def draw(self) -> list[Step]:
        """Return the next input as one step."""
        part = self._rng.choices(self._parts, self._weights)[0]
        self.kinds = (part,)
        if part == "beacon":
            made = self._mutator.mutate()
            return [Frame(made.octets, made.source, "beacon")]
        return [Frame(self._havoc[part].mutate(), b"", part)]

    def keep(self, steps: list[Step]) -> None:
        """Add these inputs to those that are mutated."""
        for step in steps:
            if isinstance(step, Frame):
                if step.note in self._havoc:
                    self._havoc[step.note].add(step.octets)
                else:
                    self._mutator.add(step.octets)


def _captures(beacons: Sequence[bytes]) -> Iterator[bytes]:
    frames = [b"\xff" * 6 + b"\x02\xdc\x90\0\0\1\x49\x53" + each for each in beacons]
    for kind in ("pcap", "pcapng", "mcap"):
        sink = io.BytesIO()
        with create_capture(sink, format=kind, compression="none") as writer:
            for number, frame in enumerate(frames, start=1):
                writer.write(Captured(number, number * 1_000_000_000, frame, len(frame)))
        yield sink.getvalue()
    sink = io.BytesIO()
    with create_capture(sink, format="mcap", compression="zstd") as writer:
        for number, frame in enumerate(frames, start=1):
            writer.write(Captured(number, number * 1_000_000_000, frame, len(frame)))
    yield sink.getvalue()


def _profiles() -> Iterator[bytes]:
    from importlib.resources import files

    folder = files("dcp_spec") / "profiles"
    for name in profile_names():
        yield (folder / f"{name}.toml").read_bytes()
