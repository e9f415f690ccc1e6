"""Build the generated codec with its harness, and compare its results with those of the Python codec."""

from __future__ import annotations

import re
import struct
import subprocess
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dcp_codec import Codec, DecodeError
from dcp_codec.export.c.files import codec_files

from .harness import RESULT, harness
from .values import plain_form

#: Options of a strict build; a warning is an error.
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_INDEX = re.compile(r".*\]\.?")


@dataclass
class Comparison:
    """Results of a comparison so far."""

    frames: int = 0
    valid: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    differences: list[str] = field(default_factory=list)


def build(codec: Codec, folder: Path, compiler: str = "cc", options: Sequence[str] = ("-O2",)) -> Path:
    """Generate and compile codec and harness in ``folder``; return the program.

    Raises ``RuntimeError`` with the compiler's messages if it reports anything.
    """
    for name, text in {**codec_files(codec), "harness.c": harness(codec)}.items():
        (folder / name).write_text(text, encoding="utf-8")
    program = folder / "harness"
    # Only the codec is built strictly and with sanitizers, not the harness.
    for given, source in (((*STRICT, *options), "dcp_codec.c"), (("-std=c99", "-O0"), "harness.c")):
        command = [compiler, *given, "-c", source, "-o", f"{source}.o"]
        found = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if found.returncode or found.stderr:
            raise RuntimeError(f"{' '.join(command)}\n{found.stderr}")
    command = [compiler, *options, "dcp_codec.c.o", "harness.c.o", "-o", str(program)]
    subprocess.run(command, cwd=folder, check=True)
    return program


class Peer:
    """A built harness beside the Python codec of the same profile."""

    def __init__(self, codec: Codec, program: Path, runner: Sequence[str] = ()) -> None:
        """``runner`` starts the program, for example an emulator."""
        self._codec = codec
        self._form: Callable[..., bytes] = plain_form(codec)
        self._command = [*runner, str(program)]

    def compare(self, frames: Sequence[bytes], into: Comparison) -> None:
        """Give frames to both codecs and add what they do to ``into``."""
        request = b"".join(struct.pack("<I", len(frame)) + frame for frame in frames)
        answer = subprocess.run(self._command, input=request, capture_output=True, check=False)
        if answer.returncode or len(answer.stdout) != RESULT.size * len(frames):
            into.differences.append(f"status {answer.returncode}: {answer.stderr.decode(errors='replace')[:2000]}")
            return
        for frame, found in zip(frames, RESULT.iter_unpack(answer.stdout), strict=True):
            into.frames += 1
            expected = self._expected(frame, into)
            reason, faults, crc, offset, needed, available, requirement, name = found
            texts = tuple(each.rstrip(b"\0").decode() for each in (requirement, name))
            got = (reason, crc, offset, needed, available, *texts)
            if got != expected or faults:
                into.differences.append(f"{frame.hex()}: C {got} faults {faults}, Python {expected}")

    def _expected(self, frame: bytes, into: Comparison) -> tuple[object, ...]:
        try:
            beacon, end = self._codec.decode_from(frame)
        except DecodeError as error:
            problem = error.problem
            into.reasons[problem.reason] += 1
            name = _INDEX.sub("", problem.path)[:48]
            numbers = ((problem.needed or 0) & _ALL, (problem.available or 0) & _ALL)
            return (_NUMBERS[problem.reason], 0, problem.offset, *numbers, problem.requirement or "", name)
        into.valid += 1
        return (0, zlib.crc32(self._form(beacon)), end, 0, 0, "", "")


_ALL = (1 << 64) - 1


def _numbers() -> dict[str, int]:
    from dcp_spec.reasons import REASONS

    return {name: number for number, name in enumerate(REASONS, start=1)}


_NUMBERS = _numbers()
