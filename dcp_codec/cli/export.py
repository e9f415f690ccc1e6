"""``dcp-codec export``: write the wire format for other tools."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from dcp_codec.codec import Codec
from dcp_codec.common.commandline import PROFILE_HELP, ExpectedError

from .common import load_codec

#: kind -> (module, function of a codec, help)
_KINDS = {
    "lua": ("dcp_codec.export.lua", "wireshark_dissector", "Wireshark/tshark dissector (Lua)"),
    "ksy": ("dcp_codec.export.ksy", "kaitai_struct", "Kaitai Struct specification"),
    "jsonschema": ("dcp_codec.export.jsonschema", "frame_schema", "JSON Schema of 'decode --format jsonl'"),
    "markdown": ("dcp_codec.export.markdown", "format_tables", "Markdown tables with bit offsets"),
    "scapy": ("dcp_codec.scapy.layers", "export_script", "start-up script for scapy with the layers loaded"),
}


@click.command("export")
@click.argument("kind", type=click.Choice(list(_KINDS)))
@click.option("-p", "--profile", required=True, metavar="NAME|FILE", help=PROFILE_HELP)
@click.option("-o", "--out", metavar="FILE", help="Write to this file.  [default: standard output]")
def command(kind: str, profile: str, out: str | None) -> int:
    """Write the wire format of a profile for another tool.

    \b
    lua         Wireshark dissector, also for tshark -X lua_script:FILE
    ksy         Kaitai Struct, for kaitai-struct-compiler -t LANGUAGE FILE
    jsonschema  JSON Schema of the output of 'decode --format jsonl'
    markdown    tables of all records with bit offsets
    scapy       a scapy session with the DCP layers, for scapy -c FILE

    'dcp-codec wireshark install' installs dissectors. Exit status: 0 all good, 2 wrong usage, or a file that cannot be
    written.
    """
    codec = load_codec(profile)
    text = _text(kind, codec, profile)
    if out is None:
        click.echo(text, nl=not text.endswith("\n"))
        return 0
    try:
        Path(out).write_text(text if text.endswith("\n") else text + "\n", encoding="utf-8")
    except OSError as error:
        raise ExpectedError(f"{out}: cannot be written: {error.strerror}") from None
    return 0


def _text(kind: str, codec: Codec, profile: str) -> str:
    module, name, _ = _KINDS[kind]
    function: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    result = function(profile if kind == "scapy" else codec)
    return result if isinstance(result, str) else json.dumps(result, indent=2)
