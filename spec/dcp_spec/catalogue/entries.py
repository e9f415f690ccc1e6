"""A catalogue of this package: entries with an id in a TOML file, read at the first look-up."""

import difflib
from collections.abc import Iterable, Mapping
from importlib import resources
from types import MappingProxyType
from typing import Generic, Protocol, Self, TypeVar

import msgspec


class Entry(Protocol):
    """An entry of a catalogue: a struct with an identifier."""

    @property
    def id(self) -> str:
        """Unique in the catalogue."""


E = TypeVar("E", bound=Entry)


class UnknownEntryError(KeyError):
    """Nothing has this name; the message says which names look like it."""

    def __str__(self) -> str:
        # KeyError shows the repr of its argument, which would put quotes around a sentence.
        return str(self.args[0])

    @classmethod
    def among(cls, noun: str, name: str, known: Iterable[str]) -> Self:
        """The error for ``name``, where there are the ``known`` ones."""
        near = difflib.get_close_matches(name.upper(), known, n=3)
        hint = f"; did you mean {', '.join(near)}?" if near else ""
        return cls(f"no {noun} {name!r}{hint}")


class Catalogue(Generic[E]):
    """The entries of ``data/FILE``, tables of one name: ``[[noun]]``."""

    def __init__(self, file: str, noun: str, entry: type[E], unknown: type[UnknownEntryError]) -> None:
        self._file = file
        self._noun = noun
        self._entry = entry
        self._unknown = unknown
        self._entries: Mapping[str, E] | None = None

    def entries(self) -> Mapping[str, E]:
        """All entries by id, in the order of the file. Raises ``ValueError`` if the file holds anything else."""
        if self._entries is None:
            tables = msgspec.toml.decode(resources.files("dcp_spec").joinpath("data", self._file).read_bytes())
            if list(tables) != [self._noun]:
                raise ValueError(f"{self._file} holds {', '.join(tables) or 'nothing'}, not [[{self._noun}]] only")
            found = [msgspec.convert(table, self._entry) for table in tables[self._noun]]
            self._entries = MappingProxyType({entry.id: entry for entry in found})
        return self._entries

    def entry(self, entry_id: str) -> E:
        """The entry with this id. Raises the error of this catalogue, a ``KeyError`` that names similar ids."""
        known = self.entries()
        try:
            return known[entry_id]
        except KeyError:
            raise self._unknown.among(self._noun, entry_id, known) from None
