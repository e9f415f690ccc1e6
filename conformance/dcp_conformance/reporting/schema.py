"""The JSON Schema of ``results.json``, made from the structs that write it.

``python -m dcp_conformance.reporting.schema`` writes it to ``dcp_conformance/data/results.schema.json``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from dcp_codec.common.schemas import schema_components
from dcp_conformance.model.results import SCHEMA, RunResult

PATH = Path(__file__).resolve().parent.parent / "data" / "results.schema.json"


def results_schema() -> dict[str, Any]:
    """JSON Schema 2020-12. Further members may come within a version; readers must ignore what they do not know."""
    (reference,), definitions = schema_components([RunResult])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{SCHEMA.replace('/', ':')}",
        "title": f"Results of dcp-conformance, {SCHEMA}",
        **reference,
        "$defs": definitions,
    }


def text() -> str:
    """The schema as the file has it."""
    return msgspec.json.format(msgspec.json.encode(results_schema()), indent=2).decode() + "\n"


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
