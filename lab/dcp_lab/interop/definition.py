"""Network tests: what they are called, which network they need, and what they decide.

A network test is a function that is given a :class:`~dcp_lab.interop.scene.Scene`. It runs in virtual time and
in real time without a difference: time passes only in the waiting methods of the scene. Identifiers are
``IT_<protocol>_<subject>``, with ``-<network>`` for each network; ``data/interop-test-ids.txt`` holds all that ever
existed, and none is used twice.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from dcp_conformance.definitions.registry import Registry, define
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

if TYPE_CHECKING:
    from .scene import Scene

PACKAGE: Final = "dcp_lab.interop.network_tests"
_ID: Final = re.compile(r"IT_(?:BP|SRP|VD|NET)_[A-Z0-9]+(?:_[A-Z0-9]+)*")
_VARIANT: Final = re.compile(r"[a-z0-9][a-z0-9.+-]*")

Wire = Literal["same", "different"]


@dataclass(frozen=True, slots=True)
class Shape:
    """A network: the places of the stations, and the links between them.

    ``roles`` has one letter for each place: ``A`` and ``B`` are the two implementations of a cell. ``links`` are the
    pairs of places that hear each other; None: all do.
    """

    name: str
    roles: str
    links: tuple[tuple[int, int], ...] | None = None

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """All directions (sender, receiver), ascending."""
        count = len(self.roles)
        if self.links is None:
            return tuple((a, b) for a in range(count) for b in range(count) if a != b)
        return tuple(sorted({each for a, b in self.links for each in ((a, b), (b, a))}))

    def neighbours(self, place: int) -> tuple[int, ...]:
        """The places that hear ``place``, ascending."""
        return tuple(receiver for sender, receiver in self.pairs if sender == place)

    def hops(self, start: int, over: Collection[int] | None = None) -> dict[int, int]:
        """The number of hops from ``start`` to each place that is reached over the places of ``over``; None: all."""
        found, queue = {start: 0}, [start]
        # The loop appends places to its list: the nearest ones first.
        for place in queue:
            for other in self.neighbours(place):
                if other not in found and (over is None or other in over):
                    found[other] = found[place] + 1
                    queue.append(other)
        return found


def _grid(count: int, columns: int) -> tuple[tuple[int, int], ...]:
    right = [(n, n + 1) for n in range(count - 1) if (n + 1) % columns]
    below = [(n, n + columns) for n in range(count - columns)]
    return tuple(sorted([*right, *below]))


PAIR: Final = Shape("pair", "AB")
LINE_3: Final = Shape("line3", "ABA", ((0, 1), (1, 2)))
LINE_5: Final = Shape("line5", "ABABA", tuple((n, n + 1) for n in range(4)))
GRID_8: Final = Shape("grid8", "ABABABAB", _grid(8, 4))
BUS_4: Final = Shape("bus4", "ABAB")
SPREAD: Final = (PAIR, LINE_3, LINE_5, GRID_8)


@dataclass(frozen=True, slots=True)
class NetworkTest:
    """One network test in one network."""

    id: str
    purpose: str
    """One line: what the test shows."""
    requirements: tuple[str, ...]
    shape: Shape
    run: Callable[[Scene], None]
    since: SpecVersion = SpecVersion.V1_0
    until: SpecVersion = SpecVersion.V2_0
    """First and last version of the specification that the test applies to."""
    entities: tuple[str, ...] = ("vardis",)
    """Of ``vardis`` and ``srp``: the protocols that all implementations need."""
    wire: Wire = "same"
    """Whether the implementations speak the same version, or different ones."""
    virtual_only: str = ""
    """Why the test needs virtual time; empty if it runs in real time as well."""
    rules: bool = True
    """Whether the rules of ``check`` judge the recording: not after traffic that no rule expects."""
    short: bool = False
    """Whether it belongs to the short selection (``--short``)."""
    longest_s: float = 10.0
    """About how many seconds the test takes in a pair if it fails. Long tests start first."""
    module: str = ""

    @property
    def base(self) -> str:
        """The identifier without its network and parameters."""
        return self.id.partition("-")[0]


def network_test(
    identifier: str,
    purpose: str,
    *,
    requirements: str,
    shapes: tuple[Shape, ...],
    variants: Mapping[str, Any] | None = None,
    since: SpecVersion = SpecVersion.V1_0,
    until: SpecVersion = SpecVersion.V2_0,
    entities: tuple[str, ...] = ("vardis",),
    wire: Wire = "same",
    virtual_only: str = "",
    rules: bool = True,
    talking: bool = True,
    short: bool = False,
    longest_s: float | Mapping[str, float] = 10.0,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a network test of ``body(scene)`` for each of ``shapes``; with ``variants`` of ``body(scene, value)``.

    ``requirements`` are identifiers separated by spaces. ``purpose`` may contain ``{variant}``.
    ``longest_s``: see :class:`NetworkTest`; a mapping has the seconds of each variant. ``talking``: whether every
    station that is on must still send at the end.
    Raises ``ValueError`` for an identifier of another form, ``UnknownRequirementError`` for an unknown requirement.
    """
    if not _ID.fullmatch(identifier):
        raise ValueError(f"{identifier!r} is not an identifier of a network test (IT_VD_CREATE)")
    ids = tuple(requirements.split())
    if not ids:
        raise ValueError(f"{identifier} decides no requirement")
    for each in ids:
        requirement(each)

    def decorate(body: Callable[..., None]) -> Callable[..., None]:
        tests = []
        for shape in shapes:
            for name, value in (variants or {"": None}).items():
                if name and not _VARIANT.fullmatch(name):
                    raise ValueError(f"{identifier}: {name!r} cannot be part of an identifier")

                def run(scene: Scene, value: Any = value, name: str = name) -> None:
                    body(scene, value) if name else body(scene)
                    if talking:
                        scene.expect_talking()

                tests.append(
                    NetworkTest(
                        id="-".join(filter(None, (identifier, shape.name, name))),
                        purpose=purpose.replace("{variant}", name),
                        requirements=ids,
                        shape=shape,
                        run=run,
                        since=since,
                        until=until,
                        entities=entities,
                        wire=wire,
                        virtual_only=virtual_only,
                        rules=rules,
                        short=short and shape is shapes[0],
                        longest_s=longest_s[name] if isinstance(longest_s, Mapping) else longest_s,
                        module=inspect.getmodule(body).__name__,  # type: ignore[union-attr]
                    )
                )
        return define(body, tests)

    return decorate


_REGISTRY: Final = Registry[NetworkTest](
    "network test", PACKAGE, "dcp-conformance interop --list", names_of=lambda each: (each.id, each.base)
)
all_tests = _REGISTRY.all


def select_tests(patterns: tuple[str, ...], *, short: bool = False) -> list[NetworkTest]:
    """Return the tests that identifiers, beginnings of identifiers or globs name; without any, all or the short ones.

    Raises ``UsageError`` for a pattern that matches no test.
    """
    return [each for each in _REGISTRY.select(patterns) if patterns or each.short or not short]
