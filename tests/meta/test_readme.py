"""The output shown in the README is that of the commands."""

from __future__ import annotations

import itertools
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from dcp_conformance.cli import main as conformance

from dcp_codec.cli import main

ROOT = Path(__file__).parents[2]
_SESSION = re.compile(
    r"^\$ (dcp-codec (?:decode|stats|guess)|dcp-conformance check)( [^\n#>]*)\n((?:(?!\$ |```).*\n)*)", re.MULTILINE
)
_COMMANDS = {"dcp-codec": main, "dcp-conformance": conformance}


def sessions() -> list[tuple[str, list[str]]]:
    """Every shown command that reads a recording, with the lines shown for it."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return [((command + rest).strip(), shown.splitlines()) for command, rest, shown in _SESSION.findall(text)]


def damaged_flight(folder: Path) -> None:
    """Make the recording of the README by the two commands that it shows for this."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (made,) = re.findall(r"^\$ (dcp-codec convert .*)\n\$ (printf .*)", text, re.MULTILINE)
    for command in made:
        words = command.replace("dcp-codec", str(Path(sys.executable).parent / "dcp-codec"))
        subprocess.run(words, shell=True, cwd=folder, check=True, capture_output=True)


def test_commands_name_files_that_exist():
    """Recordings, profiles and values are bundled, or made by an earlier command."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    made: set[str] = set()
    for line in re.findall(r"^\$ ((?:dcp-codec|dcp-conformance check|cat|printf) .*)", text, re.MULTILINE):
        words = line.partition("  #")[0].split()
        for before, word in itertools.pairwise(words):
            if before in (">", "-o", "--out") or (words[1] == "convert" and word == words[-1]):
                made.add(word)
            elif re.search(r"\.(mcap|pcap|toml|json)$|/$", word) and not word.startswith("of="):
                assert word in made or (ROOT / word).exists(), line


def test_there_are_sessions():
    assert len(sessions()) >= 4


@pytest.mark.parametrize(("command", "shown"), sessions(), ids=lambda value: value if isinstance(value, str) else "")
def test_shown_output_is_printed(command, shown, tmp_path, monkeypatch, capsys):
    (tmp_path / "captures").symlink_to(ROOT / "captures")
    damaged_flight(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    words = shlex.split(command)
    with pytest.raises(SystemExit):
        _COMMANDS[words[0]](words[1:])
    printed = capsys.readouterr()
    lines = [line.rstrip() for line in (printed.err + printed.out).splitlines()]
    expected = [line.rstrip() for line in shown if line.strip() not in ("", "...")]
    assert expected
    missing = [line for line in expected if line not in lines]
    assert missing == []


def programs() -> list[str]:
    """The Python programs of the README."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("program", programs(), ids=lambda text: text.splitlines()[0])
def test_programs_run_unchanged(program, capsys):
    exec(compile(program, "README.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out


def test_there_are_programs():
    assert len(programs()) >= 2


def test_the_page_that_explains_setcap_is_linked():
    (place,) = re.findall(r"`setcap`[^;]*\]\(([^)#]+)[^)]*\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert "sudo setcap" in (ROOT / place).read_text(encoding="utf-8")
