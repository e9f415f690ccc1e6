"""Values of the fields that a profile adds to VarSpec."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
from dcp_spec.profile.definition import own_fields

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.values import Container, VarCreate, VarSpec, VarUpdate


class OwnSpecFields:
    """The fields that a profile adds to VarSpec, by their names in the profile."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._container = codec.profile.vardis.container_types.create_variables
        self.names = tuple(each.name for each in own_fields(codec.profile.vardis.var_spec))

    def values(self, spec: VarSpec) -> dict[str, Any]:
        """Return the values in ``spec`` by name, in wire order; octets as ``bytes``."""
        return dict(zip(self.names, getattr(spec, "extra", ()), strict=True)) if self.names else {}

    def shown(self, spec: VarSpec) -> dict[str, int | float | str]:
        """Return :meth:`values` with octets as hexadecimal digits, for the control interface and scenarios."""
        return {name: value.hex() if isinstance(value, bytes) else value for name, value in self.values(spec).items()}

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

    def replaced(self, spec: VarSpec, given: Mapping[str, Any]) -> VarSpec:
        """Return ``spec`` with ``given`` values in these fields.

        Raises ValueError for a name that the profile does not have, or a value that the field cannot express.
        """
        known = ", ".join(self.names) or "none"
        for name in given:
            if name not in self.names:
                raise ValueError(f"a variable of this profile has no field {name!r} of its own (it has: {known})")
        extra = tuple((self.values(spec) | dict(given)).values())
        made: VarSpec = msgspec.structs.replace(spec, extra=extra)
        try:
            record = VarCreate(made, VarUpdate(spec.var_id, 0, b"\0"))
            self._codec.encode_containers((Container(self._container, (record,)),))
        except EncodeError as error:
            raise ValueError(f"a field of the variable cannot be encoded: {error}") from None
        return made
