"""Generate the page of JSON Schemas: each schema as a file to download, and its objects as tables."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dcp_codec.codec import Codec
from dcp_codec.export.jsonschema import beacon_schema

from .markdown import code, page, table


def schemas(root: Path) -> dict[str, tuple[str, Mapping[str, Any]]]:
    """Return file name -> what it describes, and the schema."""

    def read(name: str) -> Mapping[str, Any]:
        found: Mapping[str, Any] = json.loads((root / name).read_text(encoding="utf-8"))
        return found

    return {
        "results.schema.json": (
            "`results.json` of a report; written by `dcp-conformance run`, `check`, `replay` and `fuzz`",
            read("conformance/dcp_conformance/data/results.schema.json"),
        ),
        "upper-tester.schema.json": (
            "Messages of the upper tester interface, and of the control socket of `dcp-node`",
            read("spec/dcp_spec/data/upper-tester.schema.json"),
        ),
        "beacon.schema.json": (
            "A beacon as JSON in profile `dcp-2.0`: `dcp-codec decode --format jsonl`, `dcp-codec encode`; for another "
            "profile `dcp-codec export jsonschema -p NAME`",
            beacon_schema(Codec("dcp-2.0")),
        ),
    }


def schemas_page(root: Path) -> str:
    """Return the page. ``root``: the repository."""
    parts = ["JSON Schema, draft 2020-12. Readers must ignore members that they do not know."]
    for name, (about, schema) in schemas(root).items():
        parts += [f"## {name}", f"{about}. [Download]({name})"]
        parts += _objects(schema)
    return page("JSON schemas", *parts)


def _objects(schema: Mapping[str, Any]) -> Iterator[str]:
    for name, it in {"": schema, **schema.get("$defs", {})}.items():
        properties = it.get("properties", {})
        if not properties:
            continue
        if name:
            yield f"### {name}"
        yield code(str(it.get("description", "")).partition("\n\n")[0])
        required = set(it.get("required", ()))
        rows = [
            (f"`{key}`", _kind(each), "yes" if key in required else "", code(str(each.get("description", ""))))
            for key, each in properties.items()
        ]
        yield table(("Member", "Type", "Required", "Meaning"), rows)


def _kind(it: Mapping[str, Any] | bool) -> str:
    if isinstance(it, bool):
        return "anything"
    if "$ref" in it:
        return str(it["$ref"]).rpartition("/")[2]
    if "const" in it:
        return f"`{json.dumps(it['const'])}`"
    if "enum" in it:
        return ", ".join(f"`{json.dumps(each)}`" for each in it["enum"])
    for key in ("anyOf", "oneOf"):
        if key in it:
            return " or ".join(dict.fromkeys(_kind(each) for each in it[key]))
    kind = it.get("type", "anything")
    text = " or ".join(kind) if isinstance(kind, list) else str(kind)
    if kind == "array" and isinstance(it.get("items"), dict):
        return f"array of {_kind(it['items'])}"
    low, high = it.get("minimum"), it.get("maximum")
    return text + (f" {low} to {high}" if low is not None and high is not None else "")
