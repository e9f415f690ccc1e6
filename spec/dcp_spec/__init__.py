"""What the protocol is: wire profiles, construct schemas, constants, requirements, readings and parameters.

This package reads nothing but its own data and knows no sockets, clocks or files beyond profiles. The modules are the
interface: ``profile`` and ``profile_loading`` (how octets are laid out), ``schema`` (construct objects of a profile),
``requirements`` and ``readings`` (what must hold, and how disputed text is read), ``constants``, ``status`` and
``parameters`` (what the specification names), ``reasons`` (why octets are no message). The mappings of everything,
``requirements()`` and ``readings()``, are in the modules of those names, which a package cannot also export.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .exports import exported
from .version import __version__

if TYPE_CHECKING:
    from .profile import Profile
    from .profile_loading import ProfileError, load_profile, profile_names
    from .readings import reading
    from .requirements import Requirement, requirement
    from .schema import Schema, build_schema

__all__ = [
    "Profile",
    "ProfileError",
    "Requirement",
    "Schema",
    "__version__",
    "build_schema",
    "load_profile",
    "profile_names",
    "reading",
    "requirement",
]

# Who wants to know the version, or a constant, does not pay for construct.
__getattr__ = exported(
    __name__,
    {
        "profile": ("Profile",),
        "profile_loading": ("ProfileError", "load_profile", "profile_names"),
        "readings": ("reading",),
        "requirements": ("Requirement", "requirement"),
        "schema": ("Schema", "build_schema"),
    },
)
