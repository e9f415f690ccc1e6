"""``dcp-codec export``: write the wire format for other tools."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from dcp_codec.codec import Codec
from dcp_codec.common.commandline import PROFILE_HELP, writing

from .common import load_codec

#: kind -> (module, function of a codec); a kind of several files has a dictionary of texts by name
_KINDS = {
    "c": ("dcp_codec.export.c.files", "codec_files"),
    "rust": ("dcp_codec.export.rust.module", "rust_module"),
    "lua": ("dcp_codec.export.lua", "wireshark_dissector"),
    "ksy": ("dcp_codec.export.ksy", "kaitai_struct"),
    "jsonschema": ("dcp_codec.export.jsonschema", "frame_schema"),
    "markdown": ("dcp_codec.export.markdown", "format_tables"),
    "scapy": ("dcp_codec.scapy.layers", "export_script"),
}


@click.command("export")
@click.argument("kind", type=click.Choice(list(_KINDS)))
@click.option(
    "--adapter", is_flag=True, help="For c: also an adapter of the upper tester, dcp_adapter.h and dcp_adapter.c."
)
@click.option("-p", "--profile", required=True, metavar="NAME|FILE", help=PROFILE_HELP)
@click.option(
    "-o", "--out", metavar="FILE|DIR", help="Write to this file, for c to this folder.  [default: standard output]"
)
def command(kind: str, adapter: bool, profile: str, out: str | None) -> int:
    """Write the wire format of a profile for another tool.

    \b
    c           dcp_codec.h and dcp_codec.c: decoder and encoder in C99, without allocation
    rust        a module in Rust: decoder and encoder, no_std, without unsafe code
    lua         Wireshark dissector, also for tshark -X lua_script:FILE
    ksy         Kaitai Struct, for kaitai-struct-compiler -t LANGUAGE FILE
    jsonschema  JSON Schema of the output of 'decode --format jsonl'
    markdown    tables of all records with bit offsets
    scapy       a scapy session with the DCP layers, for scapy -c FILE

    'dcp-codec wireshark install' installs dissectors. Exit status: 0 all good, 2 wrong usage, or a file that cannot be
    written.
    """
    codec = load_codec(profile)
    if adapter and kind != "c":
        raise click.UsageError("--adapter belongs to the kind c")
    result = _result(kind, codec, profile)
    if adapter and isinstance(result, dict):
        from dcp_codec.export.c.adapter import adapter_files

        result |= adapter_files(codec)
    if isinstance(result, dict):
        if out is None:
            raise click.UsageError(f"{kind} consists of {' and '.join(result)}; give a folder: -o DIR")
        files = {Path(out) / name: text for name, text in result.items()}
    elif out is None:
        click.echo(result, nl=not result.endswith("\n"))
        return 0
    else:
        files = {Path(out): result if result.endswith("\n") else result + "\n"}
    for path, text in files.items():
        with writing(path):
            if isinstance(result, dict):
                path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return 0


def _result(kind: str, codec: Codec, profile: str) -> str | dict[str, str]:
    module, name = _KINDS[kind]
    function: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    result = function(profile if kind == "scapy" else codec)
    if kind == "jsonschema":
        return json.dumps(result, indent=2)
    made: str | dict[str, str] = result
    return made
