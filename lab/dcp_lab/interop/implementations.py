"""Implementations of a matrix: those of a file (TOML), and the built-in ones.

Built in is ``node:PROFILE`` (our node). Other packages offer further kinds by entry points: dcp-conformance-selftest
offers ``mutant:ID[@PROFILE]`` and ``variant:ID[@PROFILE]``. All run in virtual time and, except for variants, as
processes.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from string import Formatter
from typing import Any, Final, Literal, NamedTuple

import msgspec
from dcp_conformance.definitions.input_files import load_file
from dcp_conformance.errors import UsageError
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.profile.loading import ProfileError
from dcp_spec.profile.types import Types

from dcp_codec.codec import get_codec

from .world import Limits

#: Placeholders of ``start`` and ``upper_tester``.
PLACEHOLDERS: Final = ("interface", "node_id", "network_id", "profile", "control", "directory", "seed")
#: Group of entry points for nodes of other packages; the name of an entry point is the kind.
GROUP: Final = "dcp_conformance.nodes"
BUILT_IN: Final = tuple(f"node:dcp-{version}" for version in ("2.0", "1.3", "1.2", "1.1", "1.0"))

Ready = Literal["beacon", "upper-tester"]


class Implementation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One table ``[implementation.NAME]``."""

    start: str | list[str] = ""
    """The command, with placeholders; it stays in the foreground."""
    built_in: str = ""
    """``node``, ``mutant:ID`` or ``variant:ID`` instead of a command."""
    profile: str = "dcp-2.0"
    """The wire profile: a built-in name or a path."""
    versions: tuple[str, ...] = ()
    """Further profiles that ``{profile}`` can stand for. Two implementations meet in the first that both have."""
    upper_tester: str = ""
    """As ``--ut`` of ``run``, with placeholders; empty: none."""
    ready: Ready = "beacon"
    """The sign that the process is ready: an answer of its upper tester; without one, its first beacon or socket."""
    ready_s: float = 60.0
    """Seconds that this may take at most."""
    srp: bool = True
    """Whether it has SRP."""
    vardis: bool = True
    """Whether it has VarDis."""
    limits: Limits = Limits()
    """Parameters and capacities that differ from the usual ones."""
    parameters: dict[str, str | int | float] = {}
    """Values of further placeholders."""
    what: str = ""
    """A sentence for the reports."""

    @property
    def profiles(self) -> tuple[str, ...]:
        """All profiles, the preferred one first."""
        return tuple(dict.fromkeys((self.profile, *self.versions)))


class Matrix(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table ``[matrix]``: which cells there are."""

    tests: tuple[str, ...] = ()
    """Identifiers or globs; all without any."""
    rows: tuple[str, ...] = ()
    """Implementations in role A; all without any."""
    columns: tuple[str, ...] = ()
    """Implementations in role B; all without any."""


class Description(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A whole file."""

    implementation: dict[str, Implementation]
    matrix: Matrix = Matrix()


def load_description(path: Path) -> Description:
    """Read a file. Raises ``UsageError`` that names the file, the key and what would be right."""
    found = load_file(path, Description, decode=msgspec.toml.decode)
    for name, each in found.implementation.items():
        try:
            _check(each)
        except (UsageError, ProfileError) as error:
            raise UsageError(f"{path}: implementation.{name}: {error}") from None
    for key, names in (("rows", found.matrix.rows), ("columns", found.matrix.columns)):
        for name in names:
            if name not in found.implementation:
                known = ", ".join(found.implementation)
                raise UsageError(f"{path}: matrix.{key}: {name!r} is not described; there are {known}")
    return found


def _check(each: Implementation) -> None:
    if bool(each.start) == bool(each.built_in):
        raise UsageError("give either 'start' (a command) or 'built_in' (node, mutant:ID or variant:ID)")
    if each.ready == "upper-tester" and not each.upper_tester and not each.built_in:
        raise UsageError("ready: 'upper-tester' needs the key upper_tester")
    if each.built_in:
        virtual_setup(each, each.profile)
    texts = each.start if isinstance(each.start, list) else [each.start]
    for text in (*texts, each.upper_tester):
        try:
            names = [name for _, name, _, _ in Formatter().parse(text) if name is not None]
        except ValueError as error:
            raise UsageError(f"{text!r}: {error}; write {{{{ and }}}} for braces") from None
        for name in names:
            if name not in PLACEHOLDERS and name not in each.parameters:
                known = ", ".join(f"{{{known}}}" for known in (*PLACEHOLDERS, *each.parameters))
                raise UsageError(f"{text!r}: there is no placeholder {{{name}}}; there are {known}")
    for profile in each.profiles:
        get_codec(profile)


class OfferedNode(NamedTuple):
    """A built-in implementation of another package, offered by an entry point in the group :data:`GROUP`."""

    what: str
    """A sentence whose subject is the node, for the reports."""
    profile: str
    """The profile on which the node runs if none is given."""
    setup: Callable[[str], Setup]
    """Function of the name of a profile that returns the node. Raises ``UsageError`` if it does not exist there."""
    program: tuple[str, ...] = ()
    """Arguments of ``python -m`` for the node as a process; empty: it runs in virtual time only."""


@cache
def _offered(name: str) -> OfferedNode:
    """Return the built-in implementation ``KIND`` or ``KIND:ID`` without its profile.

    The entry point of a kind is a function of the identifier. Raises ``UsageError`` for an unknown kind, or from the
    entry point for an unknown identifier.
    """
    kind, _, identifier = name.partition(":")
    if kind == "node":
        program = ("dcp_stack.cli", "run", "--network-id", "{network_id}", "--seed", "{seed}")
        return OfferedNode("our node", "dcp-2.0", lambda profile: Setup(reference_config(get_codec(profile))), program)
    for entry in entry_points(group=GROUP, name=kind):
        found: OfferedNode = entry.load()(identifier)
        return found
    if kind in ("mutant", "variant"):
        raise UsageError(
            f"{name!r}: the {kind}s are in the package dcp-conformance-selftest: "
            "pip install ./selftest in a checkout of the kit"
        )
    raise UsageError(f"{name!r} is not a built-in implementation: node:PROFILE, mutant:ID or variant:ID")


def built_in(name: str) -> Implementation:
    """Return a built-in implementation: ``node:dcp-2.0``, ``mutant:ID@PROFILE``, ``variant:ID@PROFILE``.

    Raises ``UsageError`` for another name.
    """
    kind, _, rest = name.partition(":")
    own_name, _, profile = ("node", "", rest) if kind == "node" else name.partition("@")
    offered = _offered(own_name)
    found = Implementation(built_in=own_name, profile=profile or offered.profile, what=offered.what)
    try:
        get_codec(found.profile)
    except ProfileError as error:
        raise UsageError(str(error)) from None
    setup, limits = virtual_setup(found, found.profile)
    own = setup.config
    return msgspec.structs.replace(found, limits=limits, srp=own.srp is not None, vardis=own.vardis is not None)


@cache
def _setup_of(name: str, profile: str) -> tuple[Setup, Limits]:
    try:
        made = _offered(name).setup(profile)
    except UsageError as error:
        raise UsageError(f"built_in: {error}") from None
    return made, _limits(made)


def virtual_setup(each: Implementation, profile: str) -> tuple[Setup, Limits]:
    """Return the node of a built-in implementation in virtual time, and its limits. Raises ``UsageError``."""
    if not each.built_in:
        raise UsageError("an implementation that is a command does not run in virtual time; leave out --virtual")
    return _setup_of(each.built_in, profile)


def _limits(made: Setup) -> Limits:
    """The limits of a node, as an unchanged node with the same configuration tells them."""
    upper = VirtualUpperTester(InProcess(made.config))
    told: dict[str, Any] = {}
    for method in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
        told.update(upper.call(method, {}).result.get("parameters", {}))
    values: dict[str, Any] = {
        field: told[name] for field, name in _PARAMETERS.items() if isinstance(told.get(name), int | float)
    }
    limits = made.config.profile.limits
    if limits.max_variables is not None:
        values["variables"] = limits.max_variables
    if limits.max_neighbours is not None:
        values["neighbours"] = limits.max_neighbours
    return Limits(**values)


_PARAMETERS: Final[Mapping[str, str]] = {
    "value": "VARDISPAR_MAX_VALUE_LENGTH",
    "description": "VARDISPAR_MAX_DESCRIPTION_LENGTH",
    "repetitions": "VARDISPAR_MAX_REPETITIONS",
    "summaries": "VARDISPAR_MAX_SUMMARIES",
    "payload": "VARDISPAR_MAX_PAYLOAD_SIZE",
    "neighbour_timeout_ms": "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT",
    "scrubbing_period_ms": "VARDISPAR_SCRUBBING_PERIOD",
    "beacon_period_ms": "BPPAR_BEACON_PERIOD",
    "buffer_check_ms": "VARDISPAR_BUFFER_CHECK_PERIOD",
    "network_id": "BPPAR_NETWORK_ID",
}


def command_of(each: Implementation, profile: str, places: Mapping[str, str]) -> list[str]:
    """Return the command of a process, with its placeholders filled in."""
    if each.built_in:
        program = _offered(each.built_in).program
        if not program:
            raise UsageError(f"{each.built_in} runs in virtual time only (--virtual)")
        words = [sys.executable, "-m", *program, "-i", "{interface}", "--node-id", "{node_id}", "-p", "{profile}"]
        words += ["--control", "{control}"]
        if "--network-id" in words and not get_codec(profile).profile.has_header_field("networkId"):
            words.remove("--network-id")
            words.remove("{network_id}")
    else:
        words = list(each.start) if isinstance(each.start, list) else shlex.split(each.start)
    values = {**{name: str(value) for name, value in each.parameters.items()}, **places}
    return [word.format(**values) for word in words]


def upper_tester_of(each: Implementation, places: Mapping[str, str]) -> str:
    """Return the upper tester of a process as ``--ut`` has it; empty: none."""
    if each.built_in:
        return "unix:" + places["control"]
    values = {**{name: str(value) for name, value in each.parameters.items()}, **places}
    return each.upper_tester.format(**values)


def meeting_profile(a: Implementation, b: Implementation) -> str | None:
    """Return the first profile of ``a`` that ``b`` has as well.

    None: they never meet, because of their versions, their networks, or layouts that differ within a version.
    """
    if (
        a.limits.network_id is not None
        and b.limits.network_id is not None
        and a.limits.network_id != b.limits.network_id
    ):
        return None
    return next((each for each in a.profiles if each in b.profiles and _layout(a, each) == _layout(b, each)), None)


def _layout(each: Implementation, profile: str) -> tuple[Types, Any]:
    """Return the types of the transmitted fields, and the safety data; variants can differ from their profile."""
    found = virtual_setup(each, profile)[0].config.profile if each.built_in else get_codec(profile).profile
    return found.types, found.srp.safety_data


def resolve(names: Iterable[str], known: Mapping[str, Implementation]) -> dict[str, Implementation]:
    """Return implementations by name: those of a file, else built-in ones. Raises ``UsageError``."""
    return {name: known[name] if name in known else built_in(name) for name in names}
