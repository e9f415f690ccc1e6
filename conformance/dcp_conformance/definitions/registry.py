"""Registries: what the modules of a package define, found by identifier or pattern."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from types import ModuleType
from typing import Any, Final, Generic, Protocol, TypeVar

from dcp_conformance.errors import UsageError

_ATTRIBUTE: Final = "__dcp_entries__"
#: Maximum number of suggested names.
_NEAR: Final = 3


class Identified(Protocol):
    """An entry of a registry."""

    @property
    def id(self) -> str:
        """The identifier, unique in the registry."""
        ...


Entry = TypeVar("Entry", bound=Identified)
Defined = TypeVar("Defined")


def define(body: Defined, entries: Sequence[Identified]) -> Defined:
    """Make a function or class define entries of its module, before those that it defines already.

    This is the end of a decorator, of which a function may have several.
    """
    setattr(body, _ATTRIBUTE, (*entries, *vars(body).get(_ATTRIBUTE, ())))
    return body


def defined_in(module: ModuleType) -> Iterator[Any]:
    """Yield the entries that functions and classes of a module define, in their order."""
    for value in vars(module).values():
        if getattr(value, "__module__", None) == module.__name__:
            yield from getattr(value, "__dict__", {}).get(_ATTRIBUTE, ())


class Registry(Generic[Entry]):
    """The entries of all modules of a package, which is imported when an entry is first asked for."""

    def __init__(
        self,
        what: str,
        package: str,
        listed_by: str,
        *,
        entries_of: Callable[[ModuleType], Iterable[Entry]] = defined_in,
        names_of: Callable[[Entry], Sequence[str]] = lambda each: (each.id,),
    ) -> None:
        """``what``: the noun for an entry. ``listed_by``: the command that shows all.

        ``entries_of`` returns the entries of a module in their order, ``names_of`` what a pattern may match.
        """
        self._what = what
        self._package = package
        self._listed_by = listed_by
        self._entries_of = entries_of
        self._names_of = names_of
        self._found: dict[str, Entry] = {}

    def all(self) -> dict[str, Entry]:
        """Return all entries by identifier, by module (sorted) and order in the module.

        Raise ``ValueError`` for an identifier that is there twice.
        """
        if not self._found:
            found: dict[str, Entry] = {}
            places: dict[str, str] = {}
            for name in modules_of(self._package):
                for each in self._entries_of(importlib.import_module(name)):
                    if each.id in found:
                        raise ValueError(f"{each.id} is defined in {places[each.id]} and in {name}")
                    found[each.id], places[each.id] = each, name
            self._found = found
        return dict(self._found)

    def get(self, identifier: str) -> Entry:
        """Return the entry with an identifier. Raise ``UsageError`` with similar ones if there is none."""
        if identifier not in self.all():
            raise unknown(self._what, identifier, self._found, self._listed_by)
        return self._found[identifier]

    def select(self, patterns: Sequence[str]) -> list[Entry]:
        """Return the entries that names or globs denote, in the order of the registry; all without a pattern.

        Raise ``UsageError`` with similar names for a pattern that matches no entry.
        """
        entries = self.all()
        chosen: set[str] = set()
        for pattern in patterns:
            matching = {
                key for key, each in entries.items() if any(fnmatchcase(n, pattern) for n in self._names_of(each))
            }
            if not matching:
                names = (name for each in entries.values() for name in self._names_of(each))
                raise unknown(self._what, pattern, names, self._listed_by)
            chosen |= matching
        return [each for key, each in entries.items() if key in chosen or not patterns]


def unknown(what: str, name: str, names: Iterable[str], listed_by: str) -> UsageError:
    """Return the error for a name that nothing has, with similar ones of ``names``."""
    near = get_close_matches(name, list(dict.fromkeys(names)), n=_NEAR)
    hint = f"did you mean {', '.join(near)}? " if near else ""
    return UsageError(f"no {what} is called {name!r}; {hint}{listed_by!r} shows the {what}s")


def modules_of(package: str) -> list[str]:
    """Return the names of all modules of a package and of its packages, sorted."""
    found = []
    for info in pkgutil.iter_modules(importlib.import_module(package).__path__):
        name = f"{package}.{info.name}"
        found += modules_of(name) if info.ispkg else [name]
    return sorted(found)


__all__ = ["Registry", "define", "defined_in", "modules_of", "unknown"]
