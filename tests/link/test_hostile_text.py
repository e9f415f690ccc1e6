"""Programs beside the tester whose words hold control sequences: they are shown escaped, wherever they come out."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from pathlib import Path

from ..ports import own_port

EVIL = "[red]x[/red] \x1b[31m \x1b]0;owned\x07 \x9b31m \u202e <script>x</script>"
COMMAND = Path(sys.executable).with_name("dcp-conformance")


def harmless(text: str) -> str:
    found = re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", text)
    assert found is None, repr(text[max(0, found.start() - 60) : found.end() + 20])
    return text


def run(*words: object) -> str:
    done = subprocess.run([COMMAND, "run", *map(str, words)], capture_output=True, text=True, timeout=300, check=False)
    return harmless(done.stdout + done.stderr)


def test_the_last_output_of_a_start_command(tmp_path: Path):
    script = tmp_path / "sut"
    script.write_text("#!/bin/sh\nprintf '\\033[31mlast [red]words\\033]0;owned\\007\\n'\nexit 3\n")
    script.chmod(0o755)
    out = run("--link", f"udp:127.0.0.1:{own_port()}", "--start", script, "TC_DCP_SANITY_BV_01", "-q")
    assert r"\x1b[31mlast [red]words\x1b]0;owned\x07" in out


def test_the_name_of_an_upper_tester(tmp_path: Path):
    script = tmp_path / "ut"
    about = {"status": "UT-STATUS-OK", "contract": 1, "methods": ["UT-Hello"], "nodeId": "02:00:00:00:00:09",
             "name": EVIL, "version": EVIL, "specVersion": "2.0"}  # fmt: skip
    script.write_text(
        textwrap.dedent(f"""\
        #!{sys.executable}
        import json, sys
        for line in sys.stdin:
            call = json.loads(line)
            answer = {{"jsonrpc": "2.0", "id": call["id"]}}
            if call["method"] == "UT-Hello":
                answer["result"] = {about!r}
            else:
                answer["error"] = {{"code": -32601, "message": {EVIL!r}}}
            print(json.dumps(answer), flush=True)
        """)
    )
    script.chmod(0o755)
    report = tmp_path / "report"
    link = f"udp:127.0.0.1:{own_port()}"
    out = run("--link", link, "--ut", f"exec:{script}", "TC_DCP_SANITY_BV_01", "--report-dir", report)
    assert "[red]x[/red]" in out
    page = harmless((report / "report.html").read_text())
    assert page.count("<script>") == 1
    assert "&lt;script&gt;x" in page
    harmless((report / "junit.xml").read_text())
