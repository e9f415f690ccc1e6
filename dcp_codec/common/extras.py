"""Names of the extras that install optional packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

#: Top-level package, as imported -> extra of ``dcp-conformance-kit`` that installs it.
EXTRAS: Mapping[str, str] = MappingProxyType(
    {
        "scapy": "scapy",
        **dict.fromkeys(("mcap", "google", "zstandard", "lz4"), "mcap"),
        "yaml": "ksy",
        "pymavlink": "mavlink",
        "prometheus_client": "metrics",
        **dict.fromkeys(("greenlet", "psutil"), "conformance"),
        "pytest": "pytest",
        **dict.fromkeys(("numba", "numpy", "pyarrow"), "table"),
        "matplotlib": "plot",
        "duckdb": "duckdb",
        "mcap_ros2": "ros2",
        "distributed": "dask",
        **dict.fromkeys(("bokeh", "jinja2"), "report"),
    }
)


def advice(package: str, extra: str | None = None) -> str:
    """Return a sentence that says how to install ``package``; ``extra`` overrides the table."""
    return f"{package} is not installed: pip install 'dcp-conformance-kit[{extra or EXTRAS[package]}]'"
