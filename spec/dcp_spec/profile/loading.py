"""Find, read and validate profile files. Every complaint names the file, the key and what to do."""

from __future__ import annotations

import difflib
import functools
import importlib.resources
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from dcp_spec.constants import SpecVersion

from .definition import Profile
from .rules import contradictions as contradictions

_MAX_DEPTH = 8


class ProfileError(ValueError):
    """A profile cannot be used. The message names the profile or file, the key, and what to change."""


@functools.cache
def profile_names() -> tuple[str, ...]:
    """The names of the built-in profiles: those of the specification first, then the others, each oldest first."""
    folder = importlib.resources.files("dcp_spec").joinpath("profiles")
    names = [each.name.removesuffix(".toml") for each in folder.iterdir() if each.name.endswith(".toml")]
    return tuple(sorted(names, key=_place))


def _place(name: str) -> tuple[bool, str, list[int], str]:
    """Where a profile is listed: its family (the specification's is the first), and its version by numbers."""
    family, _, version = name.partition("-")
    return family != "dcp", family, [int(number) for number in re.findall("[0-9]+", version)], name


def load_profile(name_or_path: str | Path) -> Profile:
    """Return the built-in profile of that name, or the one in that TOML file.

    Raises :class:`ProfileError` when there is no such profile, the file cannot be read or what it says
    contradicts itself.
    """
    text = str(name_or_path)
    if text in profile_names():
        return _load_builtin(text)
    path = Path(text)
    if path.suffix != ".toml" and not _exists(path):
        near = difflib.get_close_matches(text, profile_names(), n=3, cutoff=0.4)
        hint = f"did you mean {' or '.join(near)}?" if near else "the built-in ones are: " + ", ".join(profile_names())
        raise ProfileError(
            f"unknown profile {text!r}: {hint} (a profile of your own is given as a path to a .toml file)"
        )
    return _build(_resolve(_read(path), str(path), path.parent), str(path))


def profile_from(raw: dict[str, Any], where: str) -> Profile:
    """The profile that the tables of a TOML file describe; ``extends`` can name a built-in profile only.

    ``where`` is what error messages call it. Raises :class:`ProfileError`.
    """
    return _build(_resolve(dict(raw), where, None), where)


@functools.cache
def _load_builtin(name: str) -> Profile:
    return _build(_resolve(_read_builtin(name), name, None), name)


def _read_builtin(name: str) -> dict[str, Any]:
    resource = importlib.resources.files("dcp_spec").joinpath("profiles", f"{name}.toml")
    return tomllib.loads(resource.read_text(encoding="utf-8"))


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name too long for the file system
        return False


def _read(path: Path) -> dict[str, Any]:
    try:
        octets = path.read_bytes()
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # a name that no file can have
        raise ProfileError(f"{str(path)!r}: cannot be read: {error}") from None
    try:
        return tomllib.loads(octets.decode())
    except (ValueError, RecursionError) as error:
        raise ProfileError(f"{path}: this is not a TOML file: {error}") from None


def _resolve(raw: dict[str, Any], where: str, folder: Path | None, depth: int = 0) -> dict[str, Any]:
    """Merge ``raw`` over the profile that it extends; tables merge key by key, all else is replaced."""
    base_name = raw.pop("extends", None)
    if base_name is None:
        return raw
    if not isinstance(base_name, str):
        raise ProfileError(f"{where}: extends must be the name of a profile or the path of a file, not {base_name!r}")
    if depth >= _MAX_DEPTH:
        raise ProfileError(f"{where}: extends goes round in a circle or deeper than {_MAX_DEPTH} files")
    if base_name in profile_names():
        base = _resolve(_read_builtin(base_name), base_name, None, depth + 1)
    elif folder is not None and base_name.endswith(".toml"):
        path = folder / base_name
        base = _resolve(_read(path), str(path), path.parent, depth + 1)
    else:
        known = ", ".join(profile_names())
        raise ProfileError(
            f"{where}: extends = {base_name!r} is neither a built-in profile nor a .toml file; expected one of "
            f"{known}, or the path of a .toml file"
        )
    return _merge(base, raw)


def _merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return merged


def _build(raw: dict[str, Any], where: str) -> Profile:
    _know_version(raw.get("spec_version"), where)
    try:
        profile = msgspec.convert(raw, Profile)
    except msgspec.ValidationError as error:
        raise ProfileError(f"{where}: {_explain(str(error))}") from None
    complaints = list(contradictions(profile))
    if complaints:
        raise ProfileError(f"{where}: " + "; ".join(complaints))
    return profile


def _know_version(version: object, where: str) -> None:
    """Raise ``ProfileError`` for an unknown version of the specification; None is reported by another check."""
    known = [str(each) for each in SpecVersion]
    if version is None or version in known:
        return
    hint = f'write "{version}"' if str(version) in known else f"expected one of {', '.join(known)}"
    raise ProfileError(f"{where}: spec_version = {version!r} is not a known version of the specification; {hint}")


def _explain(message: str) -> str:
    """Turn msgspec's ``... - at `$.types.var_id.width``` into ``types.var_id.width: ...``."""
    text, _, place = message.partition(" - at `$")
    key = place.rstrip("`").lstrip(".")
    if text.startswith("Object contains unknown field"):
        return f"{text}{f' in [{key}]' if key else ''}; remove it or correct its name"
    return f"{key}: {text}" if key else text
