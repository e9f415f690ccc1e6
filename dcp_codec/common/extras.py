"""Requirements that install a package which is missing."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

_KIT: Final = "dcp-conformance-kit"
_LAB: Final = "dcp-conformance-lab"
_TABLES: Final = "dcp-conformance-tables"
#: Distributions of this project -> their folders in a clone.
_FOLDERS: Final = {_KIT: ".", _LAB: "./lab", _TABLES: "./tables"}

#: Top-level package, as imported -> distribution of this project, with its extra, that installs it.
REQUIREMENTS: Mapping[str, str] = MappingProxyType(
    {
        "dcp_lab": _LAB,
        "dcp_tables": _TABLES,
        "scapy": f"{_KIT}[scapy]",
        **dict.fromkeys(("mcap", "google", "zstandard", "lz4"), f"{_KIT}[mcap]"),
        "yaml": f"{_KIT}[ksy]",
        "pymavlink": f"{_KIT}[mavlink]",
        "prometheus_client": f"{_KIT}[metrics]",
        **dict.fromkeys(("greenlet", "psutil", "jinja2"), f"{_KIT}[conformance]"),
        "hypothesis": f"{_KIT}[hypothesis]",
        "pytest": f"{_KIT}[pytest]",
        "mcap_ros2": f"{_KIT}[ros2]",
        "matplotlib": f"{_LAB}[plot]",
        **dict.fromkeys(("numba", "numpy", "pyarrow"), _TABLES),
        "duckdb": f"{_TABLES}[duckdb]",
        "distributed": f"{_TABLES}[dask]",
        "bokeh": f"{_TABLES}[report]",
    }
)


def advice(package: str) -> str:
    """Return a sentence that says how to install ``package``, from an index or in a clone of the kit."""
    requirement = REQUIREMENTS[package]
    name, bracket, extra = requirement.partition("[")
    return (
        f"{package} is not installed: pip install '{requirement}', "
        f"in a clone of the kit pip install '{_FOLDERS[name]}{bracket}{extra}'"
    )
