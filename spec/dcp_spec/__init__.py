"""The protocol as data: wire profiles, construct schemas, constants, requirements, readings and parameters.

This package reads only its own data and profiles. It uses no sockets and no clocks. The packages are
``profile`` (how octets are laid out), ``wire`` (construct schemas of a profile) and ``catalogue`` (requirements, and
readings of disputed text). The modules ``constants``, ``status``, ``parameters`` and ``reasons`` hold what the
specification names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .exports import exported
from .version import __version__

if TYPE_CHECKING:
    from .catalogue.readings import reading
    from .catalogue.requirements import Requirement, requirement
    from .profile.definition import Profile
    from .profile.loading import ProfileError, load_profile, profile_names
    from .wire.schema import Schema, build_schema

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

# Loading the version or a constant does not load construct.
__getattr__ = exported(
    __name__,
    {
        "profile.definition": ("Profile",),
        "profile.loading": ("ProfileError", "load_profile", "profile_names"),
        "catalogue.readings": ("reading",),
        "catalogue.requirements": ("Requirement", "requirement"),
        "wire.schema": ("Schema", "build_schema"),
    },
)
