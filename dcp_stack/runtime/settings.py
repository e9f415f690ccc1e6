"""Settings of ``dcp-node run`` from a TOML file and flags, and the node configuration made from them."""

from __future__ import annotations

import difflib
import random
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from dcp_spec.catalogue.readings import UnknownReadingError
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import ProfileError

from dcp_codec.codec import Codec, get_codec
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig

from .errors import NodeError


class SettingsError(NodeError):
    """Invalid settings; the message names the file, the key and the expected value."""


class SRPSettings(SRPConfig, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of SRP, and whether the node runs it."""

    enabled: bool | None = None
    """None: enabled if the profile defines the encoding of state reports."""


class VardisSettings(VardisConfig, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of VarDis, and whether the node runs it."""

    enabled: bool = True
    recommended: bool = True
    """Use the recommendations of the profile (its section ``[among]``) for keys without a value here."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All settings of one node. ``docs/dcp-node.md`` explains the keys."""

    node_id: str | None = None
    profile: str = "dcp-2.0"
    interface: str | None = None
    link: str | None = None
    control: str | None = None
    control_group: str | None = None
    control_mode: str | None = None
    record: str | None = None
    record_decoded: bool = True
    record_max_mb: Annotated[float, msgspec.Meta(gt=0)] | None = None
    record_max_minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    record_keep: Annotated[int, msgspec.Meta(ge=1)] | None = None
    position: str | None = None
    neighbour_file: str | None = None
    metrics: Annotated[int, msgspec.Meta(ge=0, le=65535)] | None = None
    user: str | None = None
    seed: int | None = None
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["text", "json"] = "text"
    log_file: str | None = None
    bp: BPConfig = BPConfig()
    srp: SRPSettings = SRPSettings()
    vardis: VardisSettings = VardisSettings()
    readings: Mapping[str, str] = msgspec.field(default_factory=dict)


_SECTIONS: dict[str, type[msgspec.Struct]] = {"bp": BPConfig, "srp": SRPSettings, "vardis": VardisSettings}


def load_settings(path: str | Path | None, flags: Mapping[str, Any]) -> Settings:
    """Return the settings of a TOML file, overridden by ``flags``.

    The keys of ``flags`` are names such as ``node_id`` and ``bp.beacon_period_ms``; a value of None overrides nothing.
    Raises SettingsError.
    """
    data = {} if path is None else _read(Path(path))
    where = "" if path is None else f"{path}: "
    _check_keys(where, data)
    for key, value in flags.items():
        if value is None:
            continue
        table = data
        *sections, name = key.split(".")
        for section in sections:
            table = table.setdefault(section, {})
        table[name] = value
    if flags.get("interface") is not None:
        data.pop("link", None)
    elif flags.get("link") is not None:
        data.pop("interface", None)
    try:
        return msgspec.convert(data, Settings)
    except msgspec.ValidationError as error:
        raise SettingsError(where + _explained(str(error))) from None


def _read(path: Path) -> dict[str, Any]:
    """Return the contents of a TOML file. Raises SettingsError if it cannot be read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: not TOML: {error}") from None


def _check_keys(where: str, data: Mapping[str, Any]) -> None:
    """Raise SettingsError for unknown keys: a misspelt one would have no effect."""
    tables: list[tuple[str, type[msgspec.Struct], Mapping[str, Any]]] = [("", Settings, data)]
    tables += [(f"{name}.", kind, data[name]) for name, kind in _SECTIONS.items() if isinstance(data.get(name), dict)]
    for prefix, kind, table in tables:
        known = kind.__struct_fields__
        for key in table:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"known keys are {', '.join(known)}"
                raise SettingsError(f"{where}unknown key {prefix + key!r}; {hint}")


def _explained(message: str) -> str:
    """Return a message of msgspec with the key first, written as in the file."""
    found = re.fullmatch(r"(.*?) - at `(?:key in )?\$\.?(.*)`", message)
    text, key = (found[1], found[2]) if found else (message, "")
    text = text.replace("`", "").replace("object", "table").replace("Expected ", "expected ")
    return f"{key}: {text}" if key else text


def codec_of(settings: Settings) -> Codec:
    """Return the codec of the profile. Raises SettingsError if there is no such profile."""
    try:
        return get_codec(settings.profile)
    except ProfileError as error:
        raise SettingsError(f"profile: {error}") from None


def node_config(settings: Settings, codec: Codec, *, default_id: bytes | None = None) -> NodeConfig:
    """Return the configuration of the node. Raises SettingsError for values that contradict each other or the profile.

    ``default_id`` is used if there is no ``node_id`` and the profile's identifiers have its length. Otherwise the node
    identifier is random.
    """
    profile = codec.profile
    if settings.node_id is not None:
        node_id = parse_node_id(settings.node_id, profile)
    elif default_id is not None and profile.types.node_id.width == len(default_id) and any(default_id):
        node_id = default_id
    else:
        node_id = random_node_id(profile)
    has_reports = codec.report_plan is not None
    srp = settings.srp if (has_reports if settings.srp.enabled is None else settings.srp.enabled) else None
    if settings.position is not None and srp is None:
        raise SettingsError("position: the node runs without SRP, which sends positions")
    if settings.neighbour_file is not None and srp is None:
        raise SettingsError("neighbour_file: the node runs without SRP, which maintains the neighbour table")
    try:
        return NodeConfig(
            node_id=node_id,
            codec=codec,
            bp=settings.bp,
            srp=srp,
            vardis=_among_others(settings.vardis, profile) if settings.vardis.enabled else None,
            readings=settings.readings,
        )
    except UnknownReadingError as error:
        raise SettingsError(f"readings: {error}") from None
    except ValueError as error:
        raise SettingsError(str(error)) from None


def _among_others(vardis: VardisSettings, profile: Profile) -> VardisSettings:
    """Return the settings with the recommendations of the profile for implementations in place of missing values."""
    if not vardis.recommended:
        return vardis
    among = profile.among
    recommended = {
        "max_payload_size": among.max_vardis_payload,
        "max_summaries": among.max_summaries,
    }
    return msgspec.structs.replace(
        vardis, **{name: value for name, value in recommended.items() if getattr(vardis, name) is None}
    )


def parse_node_id(text: str, profile: Profile) -> bytes:
    """Return the node identifier in the text form of this profile. Raises SettingsError."""
    from dcp_codec.jsonform import node_id_octets

    layout = profile.types.node_id
    try:
        octets = node_id_octets(text, layout.representation)
    except ValueError:
        raise SettingsError(f"node_id: {text!r} is not hex, as in 02:00:00:00:00:01") from None
    if layout.length is None and len(octets) != layout.width:
        raise SettingsError(
            f"node_id: {text} has {len(octets)} octets; identifiers of profile {profile.name} have {layout.width}"
        )
    return octets


def random_node_id(profile: Profile) -> bytes:
    """Return a random node identifier; a collision with another node is unlikely."""
    layout = profile.types.node_id
    chosen = random.SystemRandom()
    if layout.representation == "text":
        return f"node-{chosen.randrange(1 << 32):08x}".encode()[: layout.width or None]
    # In the form of an address: locally administered and unicast.
    first = (chosen.randrange(256) & 0xFC) | 0x02
    return bytes([first]) + chosen.randbytes(max(layout.width, 1) - 1)


def settings_text(settings: Settings) -> str:
    """Return the settings as the text of a TOML file; keys without a value are left out."""
    from dcp_codec.export.tomltext import toml_text

    return toml_text(msgspec.to_builtins(settings))
