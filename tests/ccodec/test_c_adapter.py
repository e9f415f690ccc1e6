"""The generated adapter in C: answers of the example node, and damaged lines under sanitizers."""

from __future__ import annotations

import json
import random
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from dcp_codec import get_codec
from dcp_codec.export.c.adapter import adapter_files
from dcp_codec.export.c.files import codec_files
from tests.ccodec.peer import SANITIZED, STRICT
from tests.odd_profiles import NAMES, codec_of

pytestmark = pytest.mark.tool("gcc")

ROOT = Path(__file__).resolve().parent.parent.parent
NODE = ROOT / "examples" / "c-node"
EXAMPLES = re.findall(r"^--> (.*)$", (ROOT / "conformance" / "UPPER-TESTER.md").read_text(), re.MULTILINE)
LINES = 6000
#: Replacements of a part of a line: JSON of other kinds, edges of numbers, escapes, damaged UTF-8.
PARTS = (
    *(b"0", b"-1", b"1.5", b"1e400", b"9223372036854775807", b"9223372036854775808", b"-9223372036854775808"),
    *(b'""', b'"\\u0041"', b'"\\ud83d\\ude00"', b'"\\ud83d"', b"\\", b'"', b"\xff", b"\xc3\xa9", b"\xed\xa0\x80"),
    *(b"null", b"true", b"[]", b"{}", b"[" * 40, b"{" * 3, b"}", b"]", b",", b":", b'"zz"', b'"0"', b" ", b"\t", b"\0"),
)


def built(folder: Path) -> Path:
    codec = get_codec("dcp-2.0")
    for name, text in {**codec_files(codec), **adapter_files(codec)}.items():
        (folder / name).write_text(text)
    for path in (*NODE.glob("*.[ch]"), Path(__file__).parent / "adapter_harness.c"):
        if path.name not in ("main.c", "dcp_codec.c", "dcp_codec.h", "dcp_adapter.c", "dcp_adapter.h"):
            shutil.copy(path, folder)
    sources = ["adapter_harness.c", "upper_tester.c", "node.c", "dcp_codec.c", "dcp_adapter.c"]
    subprocess.run(["gcc", "-std=c99", *SANITIZED, *sources, "-o", "harness"], cwd=folder, check=True)
    return folder / "harness"


def answers(program: Path, lines: list[bytes]) -> list[bytes]:
    """The answer to each line; empty without one."""
    request = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    found = subprocess.run([program], input=request, capture_output=True)
    assert not found.returncode, found.stderr.decode(errors="replace")
    blocks = re.findall(rb"(?:([^\n]+)\n)?\n", found.stdout)
    assert len(blocks) == len(lines)
    return blocks


def mutated(line: bytes, rng: random.Random) -> bytes:
    octets = bytearray(line)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(octets) + 1)
        match rng.randrange(5):
            case 0:
                octets[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del octets[at : at + rng.randrange(1, 8)]
            case 2:
                octets[at:at] = rng.choice(PARTS)
            case 3:
                places = [each.span() for each in re.finditer(rb'"[^"]*"|-?\d+|[{}\[\],:]', bytes(octets))]
                if places:
                    start, stop = rng.choice(places)
                    octets[start:stop] = rng.choice(PARTS)
            case _:
                octets[at:at] = octets[rng.randrange(len(octets) + 1) : at]
    return bytes(octets).replace(b"\n", b" ")


def depth(line: bytes) -> int:
    return max(line.count(b"[") + line.count(b"{"), 0)


def decoded(line: bytes) -> Any:
    try:
        return msgspec.json.decode(line)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return msgspec.UNSET


def test_lines(tmp_path: Path) -> None:
    """Good ones and damaged ones, by one program: building it with sanitizers costs more than the rest."""
    program = built(tmp_path)
    check_answers(program)
    check_damaged_lines(program)


def check_damaged_lines(program: Path) -> None:
    rng = random.Random("adapter")
    lines = [mutated(rng.choice(EXAMPLES).encode(), rng) for _ in range(LINES)]
    codes: dict[int, int] = {}
    for line, answer in zip(lines, answers(program, lines), strict=True):
        if not answer:
            continue
        found = json.loads(answer)
        for each in found if isinstance(found, list) else [found]:
            assert each["jsonrpc"] == "2.0", line
            assert ("result" in each) != ("error" in each), line
            codes[each.get("error", {}).get("code", 0)] = codes.get(each.get("error", {}).get("code", 0), 0) + 1
        parsed = decoded(line)
        # msgspec refuses numbers beyond floats, which are JSON.
        if depth(line) <= 32 and b"e400" not in line:
            refused = isinstance(found, dict) and found.get("error", {}).get("code") == -32700
            assert refused == (parsed is msgspec.UNSET), line
        if isinstance(parsed, dict) and isinstance(parsed.get("id"), str | int) and "result" in found:
            assert found["id"] == parsed["id"], line
    assert {0, -32700, -32600, -32601, -32602} <= set(codes), codes


def check_answers(program: Path) -> None:
    """A batch, a notification, values of every kind, and errors."""
    lines = [
        b'{"jsonrpc":"2.0","id":"\\u00e9","method":"RTDB-Create",'
        b'"params":{"varId":7,"repCnt":3,"descr":"\\u00e9\\ud83d\\ude00","value":"00fF"}}',
        b'{"jsonrpc":"2.0","method":"RTDB-Update","params":{"varId":7,"value":"01"}}',
        b'[{"jsonrpc":"2.0","id":1,"method":"RTDB-Read","params":{"varId":7}},'
        b'{"jsonrpc":"2.0","method":"BP-MGMT-Activate"},1]',
        b'{"jsonrpc":"2.0","id":2,"method":"SRP-UpdateSafetyData","params":{"sData":{"x":"NaN","y":-1.5e3,"z":0}}}',
        b'{"jsonrpc":"2.0","id":3,"method":"SRP-UpdateSafetyData","params":{"sData":{"x":1,"y":2}}}',
        b'{"jsonrpc":"2.0","id":4,"method":"RTDB-Read","params":{"varId":256}}',
        b"   ",
    ]
    created, silent, batch, updated, incomplete, beyond, empty = answers(program, lines)
    assert json.loads(created) == {"jsonrpc": "2.0", "id": "é", "result": {"status": "VARDIS-STATUS-OK"}}
    assert not silent
    assert not empty
    read, refused = json.loads(batch)
    assert read["result"]["value"] == "01"
    assert refused["error"]["code"] == -32600
    assert json.loads(updated)["result"]["status"] == "SRP-STATUS-OK"
    assert json.loads(incomplete)["error"]["code"] == -32602
    assert json.loads(beyond)["error"]["code"] == -32602


def test_adapters_of_all_profiles_compile(tmp_path: Path) -> None:
    for name in NAMES:
        folder = tmp_path / name
        folder.mkdir()
        codec = codec_of(name, folder)
        for file, text in {**codec_files(codec), **adapter_files(codec)}.items():
            (folder / file).write_text(text)
        command = ["gcc", *STRICT, "-fsyntax-only", "dcp_adapter.c"]
        found = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert not found.returncode, f"{name}: {found.stderr}"
