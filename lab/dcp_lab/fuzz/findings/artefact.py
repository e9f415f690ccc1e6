"""Save findings as self-contained files: ``ID.json`` with the steps, ``ID.mcap`` with the frames.

The JSON file is enough to replay the finding; the recording is for analysis with other tools.
"""

from __future__ import annotations

import hashlib
import shlex
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
from dcp_conformance.definitions.input_files import load_file
from dcp_conformance.errors import UsageError
from dcp_spec.version import __version__

from dcp_codec.capture import CaptureError, create_capture
from dcp_codec.capture import Frame as Captured
from dcp_codec.codec import Codec
from dcp_codec.framing.envelope import Envelope
from dcp_lab.fuzz.reduce.causes import Cause, decided_by
from dcp_lab.fuzz.reduce.reduction import Finding
from dcp_lab.fuzz.steps import Call, Effect, EffectKind, Frame, Step, Wait

SCHEMA: Final = 1
"""Version of the form of the JSON file."""
#: 2026-01-01, in ns since 1970: recordings of the same finding are the same octets.
_EPOCH = 1_767_225_600 * 1_000_000_000


class SavedStep(msgspec.Struct, frozen=True, omit_defaults=True):
    """One step: ``frame`` (bearer payload in hex), ``call`` (a service) or ``wait`` (beacon periods)."""

    frame: str | None = None
    valid: str = ""
    """The valid message that the frame was mutated from, in hex; empty if unknown."""
    note: str = ""
    source: str = ""
    call: str | None = None
    params: dict[str, Any] = {}
    wait: float | None = None
    model: dict[str, Any] = {}
    """A step of ``dcp_conformance.stateful``, of an artefact of ``fuzz model``."""


class SavedEffect(msgspec.Struct, frozen=True, omit_defaults=True):
    """An effect, and the step (from 0) after which it was observed."""

    kind: EffectKind
    detail: str
    step: int
    signature: str
    requirements: tuple[str, ...] = ()
    """Requirements that decide the effect; empty if unknown, and in older files."""


class SavedTarget(msgspec.Struct, frozen=True, omit_defaults=True):
    """The target: the mode of the command, and the options to use the same target again."""

    mode: Literal["codec", "stack", "live", "model"]
    name: str = ""
    mutant: str = ""
    options: str = ""
    """Options of the original command, unchanged."""


class Artefact(msgspec.Struct, frozen=True, omit_defaults=True):
    """A finding, with everything that its file contains."""

    id: str
    """``<kind>-<8 hex digits>``, a hash of profile, effect and steps: equal findings have equal identifiers."""
    tool: str
    profile: str
    seed: int
    target: SavedTarget
    effect: SavedEffect
    steps: tuple[SavedStep, ...]
    command: str
    """Command that replays the artefact."""
    schema: int = SCHEMA
    profile_text: str = ""
    """Contents of the profile file; empty for a built-in profile."""
    minimised: bool = True
    confirmed: bool = True
    """Whether the minimised steps showed the effect again from the initial state."""
    cause: Cause | None = None
    """The probable cause; None in older files, and for functions in process."""

    def as_steps(self) -> list[Step]:
        """Return the steps, none for an artefact of a model. Raises :class:`UsageError` for an invalid step."""
        if self.target.mode == "model":
            return []
        return [_step(saved, f"step {number}") for number, saved in enumerate(self.steps)]

    @property
    def frames(self) -> int:
        """Number of frames among the steps."""
        return sum(step.frame is not None for step in self.steps)

    @property
    def octets(self) -> int:
        """Total number of octets of the frames."""
        return sum(len(step.frame) // 2 for step in self.steps if step.frame is not None)


def make_artefact(
    codec: Codec,
    found: Finding,
    target: SavedTarget,
    *,
    seed: int,
    directory: Path,
    profile_text: str = "",
) -> Artefact:
    """Return the artefact of a finding that will be saved in ``directory``."""
    decides = found.cause.requirements if found.cause is not None else decided_by(found.effect)
    steps = tuple(map(_saved, found.steps))
    made = new_artefact(codec.profile.name, target, found.effect, decides, steps, seed=seed, directory=directory)
    return msgspec.structs.replace(
        made, profile_text=profile_text, minimised=found.minimised, confirmed=found.confirmed, cause=found.cause
    )


def new_artefact(
    profile: str,
    target: SavedTarget,
    effect: Effect,
    requirements: tuple[str, ...],
    steps: tuple[SavedStep, ...],
    *,
    seed: int,
    directory: Path,
) -> Artefact:
    """Return an artefact that will be saved in ``directory``. ``requirements``: those that decide the effect."""
    digest = hashlib.sha256(profile.encode() + effect.signature.encode() + msgspec.json.encode(steps))
    identifier = f"{effect.kind}-{digest.hexdigest()[:8]}"
    program = "dcp-selftest" if target.mode in ("codec", "stack") else "dcp-conformance"
    again = f"{program} fuzz replay {shlex.quote(f'{directory / identifier}.json')} {target.options}"
    return Artefact(
        id=identifier,
        tool=f"dcp-conformance {__version__}",
        profile=profile,
        seed=seed,
        target=target,
        effect=SavedEffect(effect.kind, effect.detail, effect.step, effect.signature, requirements),
        steps=steps,
        command=again.rstrip(),
    )


def save(artefact: Artefact, directory: Path) -> Path:
    """Write both files. Returns the path of the JSON file. Raises :class:`UsageError` if a file cannot be written."""
    path = directory / f"{artefact.id}.json"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.json.format(msgspec.json.encode(artefact), indent=2) + b"\n")
        if artefact.target.mode == "model":
            return path
        if artefact.target.mode != "codec" or all(step.note in ("", "beacon") for step in artefact.steps):
            told = {name: str(getattr(artefact, name)) for name in ("profile", "seed", "tool", "command")}
            about = {"dcp.fuzz": {"id": artefact.id, "effect": artefact.effect.detail, **told}}
            write_frames(directory / f"{artefact.id}.mcap", codec_of(artefact), artefact.as_steps(), about)
    except (OSError, CaptureError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from None
    return path


def write_frames(path: Path, codec: Codec, steps: list[Step], about: dict[str, dict[str, str]]) -> int:
    """Write the frames of steps as a recording. Returns their number. Raises ``CaptureError`` or ``OSError``."""
    envelope, now, number = Envelope(codec.profile.link), 0.0, 0
    period = 100_000_000
    with create_capture(path, metadata=about) as writer:
        for step in steps:
            if isinstance(step, Wait):
                now += step.periods * period
            elif isinstance(step, Frame):
                number += 1
                frame = envelope.frame(step.octets, step.source)
                writer.write(Captured(number, _EPOCH + round(now) + number, frame, len(frame)))
    return number


def load(path: Path) -> Artefact:
    """Read an artefact. Raises :class:`UsageError` if the file cannot be read or is not a valid artefact."""
    artefact = load_file(path, Artefact, what="an artefact of dcp-conformance fuzz")
    if artefact.schema != SCHEMA:
        raise UsageError(f"{path}: has schema {artefact.schema}, this version reads {SCHEMA}")
    try:
        artefact.as_steps()
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from None
    return artefact


def found_in(places: list[Path]) -> list[Path]:
    """Return the artefact files at these places (files or folders), sorted within each folder.

    Raises :class:`UsageError` for a folder without artefacts.
    """
    found: list[Path] = []
    for place in places:
        inside = sorted(set(place.glob("*-*.json"))) if place.is_dir() else [place]
        if not inside:
            raise UsageError(f"{place}: the folder contains no artefacts (KIND-XXXXXXXX.json)")
        found += inside
    return found


def codec_of(artefact: Artefact) -> Codec:
    """Return the codec of the artefact's profile. Raises :class:`UsageError` if the profile is invalid."""
    import tempfile

    from dcp_spec.profile.loading import ProfileError

    try:
        if not artefact.profile_text:
            return Codec(artefact.profile)
        with tempfile.NamedTemporaryFile(suffix=".toml") as file:
            file.write(artefact.profile_text.encode())
            file.flush()
            return Codec(Path(file.name))
    except ProfileError as error:
        raise UsageError(f"artefact {artefact.id}: {error}") from None


def _saved(step: Step) -> SavedStep:
    if isinstance(step, Frame):
        return SavedStep(frame=step.octets.hex(), valid=step.valid.hex(), note=step.note, source=step.source.hex(":"))
    if isinstance(step, Call):
        return SavedStep(call=step.method, params=step.params)
    return SavedStep(wait=step.periods)


def _step(saved: SavedStep, where: str) -> Step:
    if saved.frame is not None:
        try:
            octets, valid = bytes.fromhex(saved.frame), bytes.fromhex(saved.valid)
            source = bytes.fromhex(saved.source.replace(":", "")) or Frame(b"").source
        except ValueError as error:
            raise UsageError(f"{where}: {error}") from None
        return Frame(octets, valid, saved.note, source)
    if saved.call is not None:
        return Call(saved.call, saved.params)
    if saved.wait is not None:
        return Wait(saved.wait)
    raise UsageError(f"{where}: is neither a frame, nor a call, nor a wait")
