"""Access to the fields of a profile's ``SafetyDataT`` by their role.

Profiles have different names (``x`` or ``position_x``), types and units for a coordinate; the ``role`` of a field
identifies it. This module converts coordinates to vectors in metres or metres per second.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Final

from dcp_spec.profile.definition import Profile, SafetyField

from .geometry import Vector

Number = float | int

#: Unit of a profile -> factor to m or m/s; a field without a unit is assumed to be in m or m/s.
_FACTORS: Final = {
    "": 1.0,
    "m": 1.0,
    "km": 1000.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "m/s": 1.0,
    "dm/s": 0.1,
    "cm/s": 0.01,
    "mm/s": 0.001,
    "km/h": 1 / 3.6,
}
#: Short names in files and on command lines -> role.
ALIASES: Final = {
    "x": "position.x",
    "y": "position.y",
    "z": "position.z",
    "vx": "velocity.x",
    "vy": "velocity.y",
    "vz": "velocity.z",
}
ROLES: Final = frozenset(ALIASES.values())
_KINDS: Final = ("position", "velocity")


class FieldError(ValueError):
    """A value does not fit its field, or the profile does not have the field; the message has value and field."""


class SafetyFields:
    """Conversions between the safety data of one profile, vectors, and values by name or role."""

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        self._fields = {field.name: field for field in profile.srp.safety_data}
        self._by_role: dict[str, SafetyField] = {field.role: field for field in profile.srp.safety_data if field.role}
        self._position = self._axes("position")
        self._velocity = self._axes("velocity")
        self._zeros: dict[str, Any] = {field.name: 0 for field in self.numbers()}
        self._blank = self.complete(self._zeros)
        roles = ((kind, index, f"{kind}.{axis}") for kind in _KINDS for index, axis in enumerate("xyz"))
        # For each coordinate its kind and axis, its field, and the factor by which to divide it.
        self._coordinates = tuple(
            (kind, index, field.name, self.factor(field.name))
            for kind, index, role in roles
            if (field := self._by_role.get(role)) is not None
        )

    def _axes(self, kind: str) -> tuple[tuple[str, float] | None, ...] | None:
        """Return field name and factor for x, y and z, None for an axis without a field.

        Returns None if the profile has no vector of this kind.
        """
        axes = [self._by_role.get(f"{kind}.{axis}") for axis in "xyz"]
        # x and y are required, and give a position in a plane. A height alone is not a position.
        if axes[0] is None or axes[1] is None:
            return None
        if any(field is not None and field.unit not in _FACTORS for field in axes):
            return None
        return tuple(None if field is None else (field.name, _FACTORS[field.unit]) for field in axes)

    @property
    def has_position(self) -> bool:
        """Whether the profile has fields for a position (at least x and y) in a unit of length."""
        return self._position is not None

    @property
    def has_velocity(self) -> bool:
        """Whether the profile has fields for a velocity (at least x and y)."""
        return self._velocity is not None

    def position(self, data: Any) -> Vector | None:
        """Return the position in ``data`` (a SafetyData) in m; None without such fields or if one is not finite.

        Without a field ``position.z`` z is 0.
        """
        return _vector(data, self._position)

    def velocity(self, data: Any) -> Vector | None:
        """Return the velocity in ``data`` in m/s, otherwise as :meth:`position`."""
        return _vector(data, self._velocity)

    def place(self, values: Mapping[str, Any]) -> Vector | None:
        """Return the position in m for values by name in the units of the profile, otherwise as :meth:`position`."""
        return None if self._position is None else _vector(SimpleNamespace(**values), self._position)

    def numbers(self) -> tuple[SafetyField, ...]:
        """Return the numeric fields, in wire order."""
        return tuple(field for field in self._fields.values() if field.type != "opaque")

    def name_of(self, key: str) -> str:
        """Return the field for ``key``: its name in the profile, a role (``position.x``) or an alias (``x``, ``vx``).

        A name of the profile takes precedence over an alias. Raises :class:`FieldError` with the fields of the profile.
        """
        if key in self._fields:
            return key
        field = self._by_role.get(ALIASES.get(key, key))
        if field is not None:
            return field.name
        known = [*self._fields]
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; it has {', '.join(known) or 'none'}"
        raise FieldError(f"profile {self.profile.name} has no safety data field {key!r}{hint}")

    def column(self, key: str) -> str:
        """Return the field for ``key`` of a sample, or the role if the profile has no field for it.

        Raises :class:`FieldError` for a key that :meth:`from_sample` refuses.
        """
        role = ALIASES.get(key, key)
        if key not in self._fields and role in ROLES and role not in self._by_role:
            return role
        return self.name_of(key)

    def factor(self, name: str) -> float:
        """Return the factor from the unit of the field ``name`` to m or m/s; 1 for fields without a role."""
        field = self._fields[name]
        return _FACTORS.get(field.unit, 1.0) if field.role else 1.0

    def convert(self, name: str, value: Any) -> Number | bytes:
        """Return ``value`` in the type of the field ``name``; a float is rounded for an integer field.

        Raises :class:`FieldError` for a value that is not a number, is out of range, or is not finite for an integer
        field.
        """
        field = self._fields[name]
        if field.type == "f64" and type(value) is float:
            # The common case, first for speed: every float fits.
            return value
        if field.type == "opaque":
            if isinstance(value, bytes) and len(value) == field.octets:
                return value
            raise FieldError(f"{name} takes {field.octets} octets, not {value!r}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FieldError(f"{name} takes a number, not {value!r}")
        if field.type.startswith("f"):
            return _real(field, value)
        # Only floats are tested: an integer is finite, but may be too large for math.isfinite.
        if isinstance(value, float) and not math.isfinite(value):
            raise FieldError(f"{name} is of type {field.type} and cannot be {value}")
        whole = round(value)
        bits, signed = 8 * field.width, field.type.startswith("i")
        low, high = (-(1 << (bits - 1)) if signed else 0), (1 << (bits - signed)) - 1
        if not low <= whole <= high:
            raise FieldError(f"{name} is of type {field.type} ({low}..{high}) and cannot be {value}")
        return whole

    def complete(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return all fields of the profile, from values by name in the profile's units. Opaque fields may be missing.

        Raises :class:`FieldError` for unknown names, missing fields and invalid values.
        """
        found: dict[str, Any] = {}
        for name, value in values.items():
            if name not in self._fields:
                self.name_of(name)  # raises an error with the known names
                raise FieldError(
                    f"the field is called {self.name_of(name)!r} in profile {self.profile.name}, not {name!r}"
                )
            found[name] = self.convert(name, value)
        if len(found) == len(self._fields):
            return found
        missing = [name for name, field in self._fields.items() if name not in found and field.type != "opaque"]
        if missing:
            raise FieldError(f"safety data of profile {self.profile.name} needs {', '.join(missing)}")
        return {name: found[name] if name in found else bytes(field.octets) for name, field in self._fields.items()}

    def from_sample(self, sample: Mapping[str, Any]) -> dict[str, Any]:
        """Return all fields of the profile from a sample: roles and aliases in m or m/s, other names in their units.

        Roles without a field in the profile are left out (velocity in most profiles); missing fields become 0. Raises
        :class:`FieldError` as :meth:`complete`.
        """
        found: dict[str, Any] = dict(self._zeros)
        for key, value in sample.items():
            role = ALIASES.get(key, key)
            if key not in self._fields and role in ROLES:
                field = self._by_role.get(role)
                if field is None:
                    continue
                number = isinstance(value, int | float) and not isinstance(value, bool)
                try:
                    found[field.name] = value / self.factor(field.name) if number else value
                except OverflowError:
                    raise FieldError(f"{key} cannot be so large an integer") from None
            else:
                found[self.name_of(key)] = value
        return self.complete(found)

    def from_motion(self, position: Vector, velocity: Vector) -> dict[str, Any]:
        """Return all fields for a position (m) and a velocity (m/s), as :meth:`from_sample` does but faster."""
        found = dict(self._blank)
        for kind, index, name, factor in self._coordinates:
            found[name] = self.convert(name, (position if kind == "position" else velocity)[index] / factor)
        return found


def _real(field: SafetyField, value: Number) -> float:
    """Return a number as a float. Raises FieldError if it exceeds the range of the field."""
    try:
        real = float(value)
    except OverflowError:
        raise FieldError(f"{field.name} cannot hold so large an integer") from None
    # The largest float32 is slightly less than 2^128; a number that rounds to more cannot be encoded.
    if field.type == "f32" and math.isfinite(real) and abs(real) > 3.4028235677973366e38:
        raise FieldError(f"{field.name} is of type f32 and cannot be {value}")
    return real


def _vector(data: Any, axes: tuple[tuple[str, float] | None, ...] | None) -> Vector | None:
    """Return the attributes of ``data`` for ``axes`` as a vector in m or m/s; None if one is not finite."""
    if axes is None:
        return None
    x, y, z = (0.0 if axis is None else getattr(data, axis[0]) * axis[1] for axis in axes)
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None
