"""Generate the JSON Schema of ``results.json`` from the classes of :mod:`dcp_conformance.definitions.results`.

``python -m dcp_conformance.reporting.schema`` writes it to ``dcp_conformance/data/results.schema.json``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from dcp_codec.common.schemas import schema_components
from dcp_conformance.definitions.results import SCHEMA, RunResult

PATH = Path(__file__).resolve().parent.parent / "data" / "results.schema.json"


def results_schema() -> dict[str, Any]:
    """Return the schema (JSON Schema 2020-12).

    A later release may add members without a new schema version; readers must ignore unknown members.
    """
    (reference,), definitions = schema_components([RunResult])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{SCHEMA.replace('/', ':')}",
        "title": f"Results of dcp-conformance, {SCHEMA}",
        **reference,
        "$defs": definitions,
    }


def text() -> str:
    """Return the contents of the schema file."""
    return msgspec.json.format(msgspec.json.encode(results_schema()), indent=2).decode() + "\n"


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
