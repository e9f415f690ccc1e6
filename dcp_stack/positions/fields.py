"""The fields of a profile's ``SafetyDataT`` by what they mean.

Profiles call a coordinate ``x`` or ``position_x`` and send it as a float or an integer; ``role`` says what it is.
Here it is a vector in metres or metres per second, whatever the profile counts in.
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

#: unit of a profile -> factor to m and m/s; a field without a unit is taken to be in them.
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
#: What people write in files and on command lines -> role.
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
    """A value is for no field of the profile, or does not fit the field; the message names both."""


class SafetyFields:
    """The safety data of one profile, read as vectors and filled from values by name or role."""

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        self._fields = {field.name: field for field in profile.srp.safety_data}
        self._by_role: dict[str, SafetyField] = {field.role: field for field in profile.srp.safety_data if field.role}
        self._position = self._axes("position")
        self._velocity = self._axes("velocity")
        self._zeros: dict[str, Any] = {field.name: 0 for field in self.numbers()}
        self._blank = self.complete(self._zeros)
        roles = ((kind, index, f"{kind}.{axis}") for kind in _KINDS for index, axis in enumerate("xyz"))
        # What a coordinate is divided by, and the field it then stands in.
        self._coordinates = tuple(
            (kind, index, field.name, self.factor(field.name))
            for kind, index, role in roles
            if (field := self._by_role.get(role)) is not None
        )

    def _axes(self, kind: str) -> tuple[tuple[str, float] | None, ...] | None:
        axes = [self._by_role.get(f"{kind}.{axis}") for axis in "xyz"]
        # Two coordinates make a place on a plane; a height alone makes none.
        if axes[0] is None or axes[1] is None:
            return None
        if any(field is not None and field.unit not in _FACTORS for field in axes):
            return None
        return tuple(None if field is None else (field.name, _FACTORS[field.unit]) for field in axes)

    @property
    def has_position(self) -> bool:
        """Whether the profile has fields for a place (x and y at least) in a unit of length."""
        return self._position is not None

    @property
    def has_velocity(self) -> bool:
        """Whether the profile has fields for a velocity (x and y at least)."""
        return self._velocity is not None

    def position(self, data: Any) -> Vector | None:
        """Where ``data`` (a SafetyData) says its node is, in m; None without such fields or if one is not finite.

        A profile without ``position.z`` is on the plane z = 0.
        """
        return _vector(data, self._position)

    def velocity(self, data: Any) -> Vector | None:
        """The velocity in m/s, as :meth:`position`."""
        return _vector(data, self._velocity)

    def place(self, values: Mapping[str, Any]) -> Vector | None:
        """As :meth:`position` for values by name, in the units of the profile."""
        return None if self._position is None else _vector(SimpleNamespace(**values), self._position)

    def numbers(self) -> tuple[SafetyField, ...]:
        """The fields that hold numbers, in wire order."""
        return tuple(field for field in self._fields.values() if field.type != "opaque")

    def name_of(self, key: str) -> str:
        """The field for ``key``: its name in the profile, a role (``position.x``) or an alias (``x``, ``vx``).

        Raises :class:`FieldError` with the fields there are. A name of the profile comes before an alias.
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
        """The field that ``key`` of a sample fills, or the role where the profile has no field for it.

        Raises :class:`FieldError` for what :meth:`from_sample` would refuse.
        """
        role = ALIASES.get(key, key)
        if key not in self._fields and role in ROLES and role not in self._by_role:
            return role
        return self.name_of(key)

    def factor(self, name: str) -> float:
        """What a value of the field ``name`` is multiplied with to be in m or m/s; 1 for fields without a role."""
        field = self._fields[name]
        return _FACTORS.get(field.unit, 1.0) if field.role else 1.0

    def convert(self, name: str, value: Any) -> Number | bytes:
        """``value`` as the field ``name`` takes it: a float becomes the nearest integer where the field is one.

        Raises :class:`FieldError` for what is no number, not finite or out of range.
        """
        field = self._fields[name]
        if field.type == "f64" and type(value) is float:
            # The common case: every float fits.
            return value
        if field.type == "opaque":
            if isinstance(value, bytes) and len(value) == field.octets:
                return value
            raise FieldError(f"{name} takes {field.octets} octets, not {value!r}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FieldError(f"{name} takes a number, not {value!r}")
        if field.type.startswith("f"):
            return _real(field, value)
        # An integer is finite, and may be too large for a float.
        if isinstance(value, float) and not math.isfinite(value):
            raise FieldError(f"{name} is of type {field.type} and cannot be {value}")
        whole = round(value)
        bits, signed = 8 * field.width, field.type.startswith("i")
        low, high = (-(1 << (bits - 1)) if signed else 0), (1 << (bits - signed)) - 1
        if not low <= whole <= high:
            raise FieldError(f"{name} is of type {field.type} ({low}..{high}) and cannot be {value}")
        return whole

    def complete(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """All fields of the profile, from values by name in the profile's own units. Opaque fields may be missing.

        Raises :class:`FieldError` for names that are not the profile's, for missing ones and for bad values.
        """
        found: dict[str, Any] = {}
        for name, value in values.items():
            if name not in self._fields:
                self.name_of(name)  # says which names there are
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
        """All fields of the profile from a sample: roles and aliases in m and m/s, the profile's names in its units.

        Roles that the profile has no field for are left out (velocity, for most profiles), other fields become 0.
        Raises :class:`FieldError` as :meth:`complete`.
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
        """As :meth:`from_sample` for a place (m) and a velocity (m/s); this is what is asked for all the time."""
        found = dict(self._blank)
        for kind, index, name, factor in self._coordinates:
            found[name] = self.convert(name, (position if kind == "position" else velocity)[index] / factor)
        return found


def _real(field: SafetyField, value: Number) -> float:
    try:
        real = float(value)
    except OverflowError:
        raise FieldError(f"{field.name} cannot hold so large an integer") from None
    # The largest float32 is a little below 2^128; what rounds to more cannot be encoded.
    if field.type == "f32" and math.isfinite(real) and abs(real) > 3.4028235677973366e38:
        raise FieldError(f"{field.name} is of type f32 and cannot be {value}")
    return real


def _vector(data: Any, axes: tuple[tuple[str, float] | None, ...] | None) -> Vector | None:
    if axes is None:
        return None
    x, y, z = (0.0 if axis is None else getattr(data, axis[0]) * axis[1] for axis in axes)
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None
