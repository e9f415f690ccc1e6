"""Families of mutants: nodes that differ in the same method or the same attributes, one line each.

A family is made of a method or property of a part of the node, by a function that says how the behaviour differs
(:func:`instead`, :func:`after`, :func:`around`, :func:`before`, :func:`then`, :func:`skips`, :func:`crashes`), or of
the attributes of a class (:func:`attributes`). Calling it makes one mutant.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

from dcp_spec.constants import SpecVersion

from .mutant import mutant

Part = TypeVar("Part")
P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Family(Generic[P, R]):
    """Mutants that override ``method`` of ``base``, or its attributes only."""

    base: type
    method: str
    override: Callable[[Callable[P, R], type], object]
    """Function of the faulty behaviour and the class of the mutant that returns the overriding method."""
    module: str = ""
    """Module of mutants without a method."""

    def __call__(
        self,
        fault: str,
        requirements: str,
        what: str,
        behaviour: Callable[P, R] | None = None,
        *,
        since: SpecVersion | None = None,
        until: SpecVersion | None = None,
        unseen: Mapping[str, str] | None = None,
        **attributes: object,
    ) -> None:
        """Add a mutant to the module of ``behaviour``. The other arguments are those of :func:`~.mutant.mutant`."""
        name = f"M-{requirements.split()[0]}-{fault}"
        made = self.part(behaviour, class_name=name, **attributes)
        mutant(fault, requirements, what, since=since, until=until, unseen=unseen)(made)
        setattr(sys.modules[made.__module__], name, made)

    def part(
        self, behaviour: Callable[P, R] | None = None, *, class_name: str = "Changed", **attributes: object
    ) -> type:
        """Return a subclass of ``base`` with this behaviour and these attributes."""
        module = behaviour.__module__ if behaviour is not None else self.module
        made = type(class_name, (self.base,), {"__module__": module, **attributes})
        if behaviour is not None:
            override: Any = self.override(behaviour, made)
            is_property = isinstance(inspect.getattr_static(self.base, self.method), property)
            setattr(made, self.method, property(override) if is_property else override)
        return made


def _name(method: Callable[..., Any]) -> str:
    """Return the name of a method or of a property."""
    name: str = getattr(method, "fget", method).__name__
    return name


def instead(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[Concatenate[Part, P], R]:
    """Return the family whose behaviour replaces ``method`` of ``base``."""
    return Family(base, _name(method), lambda behaviour, _: behaviour)


def after(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[Concatenate[Part, R, P], R]:
    """Return the family that changes the result of ``method``: a function of object, result and arguments."""
    name = _name(method)

    def override(behaviour: Callable[Concatenate[Part, R, P], R], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> R:
            found: Any = getattr(super(made, self), name)
            return behaviour(self, found(*args, **kwargs) if callable(found) else found, *args, **kwargs)

        return changed

    return Family(base, name, override)


def around(
    base: type[Part], method: Callable[Concatenate[Part, P], R]
) -> Family[Concatenate[Part, Callable[P, R], P], R]:
    """Return the family that calls ``method`` itself: a function of object, method and arguments."""
    name = method.__name__

    def override(behaviour: Callable[Concatenate[Part, Callable[P, R], P], R], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> R:
            return behaviour(self, getattr(super(made, self), name), *args, **kwargs)

        return changed

    return Family(base, name, override)


def before(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[Concatenate[Part, P], object]:
    """Return the family that does something else, with the same arguments, before ``method``."""
    name = method.__name__

    def override(behaviour: Callable[Concatenate[Part, P], object], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> R:
            behaviour(self, *args, **kwargs)
            result: R = getattr(super(made, self), name)(*args, **kwargs)
            return result

        return changed

    return Family(base, name, override)


def then(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[Concatenate[Part, R, P], object]:
    """Return the family that does something else after ``method``: a function of object, result and arguments."""
    name = method.__name__

    def override(behaviour: Callable[Concatenate[Part, R, P], object], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> R:
            result: R = getattr(super(made, self), name)(*args, **kwargs)
            behaviour(self, result, *args, **kwargs)
            return result

        return changed

    return Family(base, name, override)


def skips(base: type[Part], method: Callable[Concatenate[Part, P], None]) -> Family[Concatenate[Part, P], bool]:
    """Return the family that does not call ``method`` if a condition on the object and the arguments is true."""
    name = method.__name__

    def override(behaviour: Callable[Concatenate[Part, P], bool], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> None:
            if not behaviour(self, *args, **kwargs):
                getattr(super(made, self), name)(*args, **kwargs)

        return changed

    return Family(base, name, override)


def crashes(
    base: type[Part], method: Callable[Concatenate[Part, P], R], error: Exception
) -> Family[Concatenate[Part, P], object]:
    """Return the family that raises a copy of ``error`` if a condition on object and arguments is true."""

    def override(behaviour: Callable[Concatenate[Part, P], object], made: type) -> object:
        def changed(self: Part, /, *args: P.args, **kwargs: P.kwargs) -> R:
            if behaviour(self, *args, **kwargs):
                raise type(error)(*error.args)
            result: R = getattr(super(made, self), method.__name__)(*args, **kwargs)
            return result

        # A finding is named by the function that raises.
        changed.__code__ = changed.__code__.replace(co_name=method.__name__)
        return changed

    return Family(base, method.__name__, override)


def assign(target: object, **values: object) -> None:
    """Set attributes of ``target``."""
    for name, value in values.items():
        setattr(target, name, value)


def attributes(base: type, module: str) -> Family[..., Any]:
    """Return the family of ``module`` whose mutants have other attributes than ``base``."""
    return Family(base, "", lambda behaviour, _: behaviour, module)


__all__ = ["Family", "after", "around", "assign", "attributes", "before", "crashes", "instead", "skips", "then"]
