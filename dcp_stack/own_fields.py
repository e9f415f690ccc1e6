"""Values of the fields that a profile adds to VarSpec, to the records of VarDis, and to state reports.

A node stores the values of received records and forwards them. A record of its own has the values that the application
gives, else those of the rules, else zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, TypeVar

import msgspec

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.plan.layout import neutral
from dcp_codec.values import AnyRecord, Container, Extra, VarCreate, VarSpec, VarUpdate

#: Returns the value of one field for a record that the node makes; its other fields are those to be sent.
Rule = Callable[[Any], int | float | bytes]
Variable = TypeVar("Variable", VarCreate, VarSpec, VarUpdate)
#: Rules of this code base by record and field, for example ``"VarUpdate.ttl"``; add new ones here.
FIELD_RULES: Final[Mapping[str, Rule]] = MappingProxyType({})
NO_VALUES: Final[Mapping[str, Any]] = MappingProxyType({})


class OwnFields:
    """The fields that a profile adds to records, by their names in the profile. True if there are any."""

    def __init__(self, codec: Codec, rules: Mapping[str, Rule]) -> None:
        """``rules`` replace :data:`FIELD_RULES`; those for fields that the profile does not have are ignored."""
        rules = {**FIELD_RULES, **rules}
        self._codec = codec
        self._rules: dict[str, dict[str, Rule]] = {
            record: {each.name: rules.get(f"{record}.{each.name}", _always(neutral(each))) for each in own}
            for record, own in codec.profile.own_fields().items()
        }

    def __bool__(self) -> bool:
        return bool(self._rules)

    def values(self, record: Any) -> dict[str, Any]:
        """Return the values in ``record`` by name, in wire order; octets as ``bytes``."""
        name = type(record).__name__
        return self.named(name, record.extra) if name in self._rules else {}

    def named(self, record: str, extra: Extra) -> dict[str, Any]:
        """Return the values ``extra`` of a record by name; ``record`` is the name of its type."""
        return dict(zip(self._rules[record], extra, strict=True))

    def shown(self, spec: VarSpec, kept: Mapping[str, Extra] = NO_VALUES) -> dict[str, int | float | str]:
        """Return the values of ``spec`` and of its stored records (:meth:`keep`) for the control interface.

        Octets are hexadecimal digits. Of several fields with the same name that of the VarSpec is shown.
        """
        found: dict[str, Any] = {}
        for record, extra in kept.items():
            found |= self.named(record, extra)
        found |= self.values(spec)
        return {name: value.hex() if isinstance(value, bytes) else value for name, value in found.items()}

    def parsed(self, given: Mapping[str, int | float | str]) -> dict[str, Any]:
        """Convert values of the form of :meth:`shown` to octets. Raises ValueError for invalid digits."""
        found: dict[str, Any] = dict(given)
        for name, value in given.items():
            if isinstance(value, str):
                try:
                    found[name] = bytes.fromhex(value)
                except ValueError:
                    raise ValueError(f"field {name!r}: octets are given as hexadecimal digits, not {value!r}") from None
        return found

    def filled(
        self,
        record: AnyRecord,
        given: Mapping[str, Any] = NO_VALUES,
        kept: Mapping[str, Extra] = NO_VALUES,
    ) -> AnyRecord:
        """Return ``record``, with the records in it, with values for all fields that the profile adds.

        ``kept``: the values of a stored record (:meth:`keep`). ``given``: values by name, which replace others; a name
        that the VarSpec and the VarUpdate of a VarCreate have is set in both.
        """
        if not self._rules:
            return record
        if isinstance(record, VarCreate):
            spec, update = self.filled(record.spec, given), self.filled(record.upd, given, kept)
            record = msgspec.structs.replace(record, spec=spec, upd=update)
        name = type(record).__name__
        if (rules := self._rules.get(name)) is None:
            return record
        extra = kept.get(name) or getattr(record, "extra", ()) or tuple([rule(record) for rule in rules.values()])
        values = self.named(name, extra)
        values.update((field, given[field]) for field in rules if field in given)
        return self._codec.types.extended(record, tuple(values.values()))

    def keep(self, kept: dict[str, Extra], record: Any) -> None:
        """Store the values in a record, except those in its VarSpec, in ``kept`` by the names of types."""
        if not self._rules:
            return
        if isinstance(record, VarCreate):
            self.keep(kept, record.upd)
        if (name := type(record).__name__) in self._rules:
            kept[name] = record.extra

    def replaced(self, record: Variable, given: Mapping[str, Any]) -> Variable:
        """Return :meth:`filled` with ``given`` values.

        Raises ValueError for a name that the profile does not have, or a value that the field cannot express.
        """
        if not given:
            return self.filled(record)
        parts = ("VarSpec", "VarUpdate", "VarCreate") if isinstance(record, VarCreate) else (type(record).__name__,)
        names = [name for part in parts for name in self._rules.get(part, ())]
        for name in given:
            if name not in names:
                known = ", ".join(names) or "none"
                raise ValueError(f"a variable of this profile has no field {name!r} of its own (it has: {known})")
        made = self.filled(record, given)
        tried = VarCreate(made, VarUpdate(made.var_id, 0, b"\0")) if isinstance(made, VarSpec) else made
        number = self._codec.profile.vardis.container_types.by_name()[tried.IC_TYPE.label]
        try:
            self._codec.encode_containers((Container(number, (tried,)),))
        except EncodeError as error:
            raise ValueError(f"a field of the variable cannot be encoded: {error}") from None
        return made


def _always(value: float | bytes) -> Rule:
    """Return a rule for a field without one."""
    return lambda _record: value
