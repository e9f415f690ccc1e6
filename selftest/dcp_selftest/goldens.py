"""Recordings with provenance: ``captures/*.mcap`` and the manifest of their contents.

``dcp-selftest goldens verify captures/manifest.toml`` checks that the files are those of the manifest,
that each has the original recording attached, and that the codec reads the values that an independent decoder found.
``make`` rebuilds the files from the recordings in a folder or from those attached to the existing files.

A build with the same versions of this tool, of the mcap library and of zstandard (which compresses the chunks) gives
the same octets; the manifest has these versions. Other versions give another file with the same contents, so ``verify``
never builds.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec
from dcp_spec.profile.loading import ProfileError
from dcp_spec.version import __version__

from dcp_codec.capture import CaptureError, Frame, attachments, convert, extract_attachment, open_capture
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.export.tomltext import toml_text
from dcp_codec.foxglove.channels import DecodedChannels, capture_metadata
from dcp_codec.framing.frames import FrameDissector
from dcp_codec.framing.locate import OtherTraffic
from dcp_codec.values import Beacon, Container, VarCreate, VarUpdate

_HEADER = """\
# Recordings, where they come from, and what is in them.
# The expected counts are those of an independent decoder; all else is written by the command.
# Verify: dcp-selftest goldens verify captures/manifest.toml

"""

#: Maximum number of findings of one kind about one file; the others are only counted.
_MAX_ALIKE = 5


class Sender(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The beacons of one sender: their number, and the first and the last sequence number in the order of the
    recording.
    """

    beacons: int
    first_seqno: int
    last_seqno: int


class SentValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The last value sent for a variable, by any node: sequence number, and octets in hex."""

    seqno: int
    value: str


class Counts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Counts of a recording.

    ``padded`` are frames with octets after the beacon, ``srp`` and ``vardis`` payload blocks. ``containers`` and
    ``records`` have the name of the container type as keys; absent types are left out.
    """

    beacons: int
    srp: int
    vardis: int
    padded: int
    containers: dict[str, int]
    records: dict[str, int]
    senders: dict[str, Sender]
    last_sent_value: dict[str, SentValue]


class Golden(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One recording of the manifest. Paths are relative to the manifest, hashes SHA-256 in hex."""

    file: str
    profile: str
    what: str
    origin: str
    #: Name of the original recording, which is attached to the file.
    original: str
    command: str = ""
    original_sha256: str = ""
    sha256: str = ""
    frames: int = 0
    expected: Counts | None = None


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``manifest.toml``: the recordings, and the versions of the tools that made the files (package -> version)."""

    made_with: dict[str, str]
    capture: tuple[Golden, ...]


class Finding(msgspec.Struct, frozen=True):
    """A difference between ``file`` and the manifest. ``check`` is one of:

    ``file``, ``hash``, ``capture``, ``attachment``, ``frames``, ``decode``, ``encode``, ``counts``, ``manifest``.
    """

    file: str
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.file}: {self.check}: {self.message}"


class GoldensError(Exception):
    """The manifest, or an original recording, cannot be used."""


def load_manifest(path: Path) -> Manifest:
    """Read a manifest. Raises :class:`GoldensError` naming the file and the key."""
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Manifest)
    except OSError as error:
        raise GoldensError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise GoldensError(f"{path}: {error}") from None


# -- verify -------------------------------------------------------------------------------------------------------


def verify(manifest: Path) -> list[Finding]:
    """Check every recording of a manifest; return no findings if all match. Raises :class:`GoldensError`.

    Checks the hash of the file; the hash of the attached recording, and that its frames are those of the file; that
    every frame is a beacon without errors that encodes to the same octets; and the counts. A recording beside the
    manifest that the manifest does not name is a finding, too.
    """
    goldens = load_manifest(manifest).capture
    named = [golden.file for golden in goldens]
    findings = [finding for golden in goldens for finding in _verify_one(manifest.parent, golden)]
    findings += [
        Finding(path.name, "manifest", "is not in the manifest")
        for path in sorted(manifest.parent.glob("*.mcap"))
        if path.name not in named
    ]
    return findings + [
        Finding(name, "manifest", "is in the manifest twice") for name in sorted(set(named)) if named.count(name) > 1
    ]


def _verify_one(folder: Path, golden: Golden) -> list[Finding]:
    path = folder / golden.file
    if not path.is_file():
        return [Finding(golden.file, "file", "there is no such file")]
    findings: list[Finding] = []
    try:
        if (found := _sha256(path)) != golden.sha256:
            findings.append(Finding(golden.file, "hash", f"SHA-256 is {found}, not {golden.sha256 or 'stated'}"))
        codec = Codec(golden.profile)
        with open_capture(path) as reader:
            frames = list(reader)
            findings += [Finding(golden.file, "capture", problem.message) for problem in reader.problems]
        findings += [Finding(golden.file, "attachment", text) for text in _attachment(path, golden, frames)]
    except (CaptureError, ProfileError, OSError) as error:
        return [*findings, Finding(golden.file, "capture", str(error))]
    if len(frames) != golden.frames:
        findings.append(Finding(golden.file, "frames", f"there are {len(frames)}, not {golden.frames}"))
    tally = Tally(codec)
    findings += [Finding(golden.file, check, text) for check, text in _few(tally.count(frames))]
    findings += [Finding(golden.file, "counts", text) for text in _differences(golden.expected, tally.counts())]
    return findings


def _attachment(path: Path, golden: Golden, frames: list[Frame]) -> Iterator[str]:
    """Yield the differences of the recording that is attached to a file with these frames."""
    found = [attachment for attachment in attachments(path) if attachment.name == golden.original]
    if len(found) != 1:
        yield f"there are {len(found)} called {golden.original}, not one"
        return
    with tempfile.TemporaryDirectory() as folder:
        original = Path(folder) / "original"
        extract_attachment(path, found[0], original)
        if (digest := _sha256(original)) != golden.original_sha256:
            yield f"{golden.original} has the SHA-256 {digest}, not {golden.original_sha256 or 'stated'}"
        with open_capture(original) as reader:
            for number, (theirs, ours) in enumerate(zip_longest(map(_content, reader), map(_content, frames)), start=1):
                if theirs != ours:
                    yield f"{golden.original} and the file differ from frame {number} on"
                    return


def _content(frame: Frame) -> tuple[int, bytes, int]:
    return frame.time_ns, frame.data, frame.orig_len


def _few(complaints: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the first findings of each kind, and the number of the others."""
    kinds: dict[str, list[str]] = {}
    for check, text in complaints:
        kinds.setdefault(check, []).append(text)
    few = []
    for check, texts in kinds.items():
        few += [(check, text) for text in texts[:_MAX_ALIKE]]
        if len(texts) > _MAX_ALIKE:
            few.append((check, f"and {len(texts) - _MAX_ALIKE} more of this kind"))
    return few


class Tally:
    """Counts the contents of the frames of a recording, with the strict decoder."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._names = codec.profile.vardis.container_names()
        self._scalars = dict.fromkeys(("beacons", "srp", "vardis", "padded"), 0)
        self._containers: dict[str, int] = {}
        self._records: dict[str, int] = {}
        self._senders: dict[str, Sender] = {}
        self._values: dict[str, SentValue] = {}

    def count(self, frames: Iterable[Frame]) -> Iterator[tuple[str, str]]:
        """Count ``frames``; yield (check, sentence) for each that is not a beacon or encodes to other octets."""
        dissector = FrameDissector(self._codec)
        for frame in frames:
            dissected = dissector.dissect(frame)
            if isinstance(dissected, OtherTraffic):
                yield "decode", f"frame {frame.number} is not DCP ({dissected.reason})"
                continue
            problems = dissected.dissection.errors
            octets = frame.data[dissected.framing.start : dissected.framing.end]
            try:
                beacon, end = self._codec.decode_from(octets)
            except DecodeError as error:
                yield "decode", f"frame {frame.number}: {error.problem.moved(dissected.framing.start)}"
                continue
            if problems:
                yield "decode", f"frame {frame.number}: decoded, although {problems[0]}"
            if self._codec.encode(beacon) != octets[:end]:
                yield "encode", f"frame {frame.number}: the beacon encodes to other octets"
            self._scalars["beacons"] += 1
            self._scalars["padded"] += end < len(octets)
            self._beacon(beacon, dissected.sender or "")

    def _beacon(self, beacon: Beacon, sender: str) -> None:
        if beacon.bp is not None:
            known = self._senders.get(sender)
            seqno = beacon.bp.seqno
            self._senders[sender] = (
                Sender(known.beacons + 1, known.first_seqno, seqno) if known else Sender(1, seqno, seqno)
            )
        for payload in beacon.payloads:
            self._scalars["srp"] += payload.srp is not None
            self._scalars["vardis"] += payload.vardis is not None
            for container in payload.vardis or ():
                self._container(container)

    def _container(self, container: Container) -> None:
        name = self._names[container.ic_type]
        self._containers[name] = self._containers.get(name, 0) + 1
        self._records[name] = self._records.get(name, 0) + len(container.records)
        for record in container.records:
            update = record.upd if isinstance(record, VarCreate) else record
            if isinstance(update, VarUpdate):
                self._values[str(update.var_id)] = SentValue(update.seqno, update.value.hex())

    def counts(self) -> Counts:
        """Return the counts so far."""
        return Counts(
            **self._scalars,
            containers=dict(sorted(self._containers.items())),
            records=dict(sorted(self._records.items())),
            senders=dict(sorted(self._senders.items())),
            last_sent_value=dict(sorted(self._values.items(), key=lambda item: int(item[0]))),
        )


def _differences(expected: Counts | None, found: Counts) -> Iterator[str]:
    if expected is None:
        yield "the manifest has no counts for the file"
        return
    wanted, there = (dict(_leaves(msgspec.to_builtins(counts))) for counts in (expected, found))
    for name in sorted({*wanted, *there}):
        if wanted.get(name) != there.get(name):
            yield f"{name} is {there.get(name, 'absent')}, expected {wanted.get(name, 'absent')}"


def _leaves(tree: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{path}{name} / ")
        else:
            yield f"{path}{name}", value


# -- make ---------------------------------------------------------------------------------------------------------


def make(manifest: Path, originals: Path | None = None) -> Manifest:
    """Rebuild every file of a manifest, write the manifest with the new hashes, and return it.

    ``originals`` is the folder with the recordings; without it the recordings attached to the existing files are used.
    Expected counts come from the ``.json`` of the same name beside a recording, made by an independent decoder; without
    that file they stay unchanged. Raises :class:`GoldensError`; the manifest is written last.
    """
    old = load_manifest(manifest)
    new = Manifest(made_with=_versions(), capture=tuple(_make_one(manifest, each, originals) for each in old.capture))
    manifest.write_text(_HEADER + toml_text(msgspec.to_builtins(new)), encoding="utf-8")
    return new


def _make_one(manifest: Path, golden: Golden, originals: Path | None) -> Golden:
    target = manifest.parent / golden.file
    try:
        codec = Codec(golden.profile)
        with tempfile.TemporaryDirectory() as folder:
            if originals is None:
                original = Path(folder) / golden.original
                _take_out(target, golden.original, original)
            else:
                original = originals / golden.original
            fresh = Path(folder) / "fresh.mcap"
            report = convert(
                original,
                fresh,
                messages=DecodedChannels(codec),
                metadata=capture_metadata(codec, {"what": golden.what, "origin": golden.origin}),
                attach_source=True,
            )
            if report.problems:
                raise GoldensError(f"{original}: {report.problems[0].message}")
            target.write_bytes(fresh.read_bytes())
            return msgspec.structs.replace(
                golden,
                command=f"dcp-selftest goldens make captures/{manifest.name} --originals FOLDER",
                original_sha256=_sha256(original),
                sha256=_sha256(target),
                frames=report.frames,
                expected=_independent(original.with_name(f"{original.stem}.json")) or golden.expected,
            )
    except (CaptureError, ProfileError, OSError) as error:
        raise GoldensError(f"{golden.file}: {error}") from error


def _take_out(path: Path, name: str, target: Path) -> None:
    for attachment in attachments(path):
        if attachment.name == name:
            extract_attachment(path, attachment, target)
            return
    raise GoldensError(f"{path}: has no attachment called {name}")


def _independent(path: Path) -> Counts | None:
    """Return the counts in the ``.json`` beside a recording, where "containers NAME" and "records NAME" are groups."""
    if not path.is_file():
        return None
    try:
        found = msgspec.json.decode(path.read_bytes())
        counts: dict[str, Any] = {"beacons": 0, "srp": 0, "vardis": 0, "padded": 0, "containers": {}, "records": {}}
        for key, number in found["counts"].items():
            group, _, name = key.partition(" ")
            if name:
                counts[group][name] = number
            else:
                counts[key] = number
        values = {name: {"seqno": seqno, "value": value} for name, (seqno, value) in found["last_sent_value"].items()}
        senders = dict(sorted(found["senders"].items()))
        return msgspec.convert({**counts, "senders": senders, "last_sent_value": values}, Counts)
    except (msgspec.MsgspecError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise GoldensError(f"{path}: does not hold counts ({error})") from error


def _versions() -> dict[str, str]:
    libraries = {name: importlib.metadata.version(name) for name in ("mcap", "zstandard")}
    return {"dcp-codec": __version__, **libraries}


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
