"""Sessions as people have them: fresh processes that import scapy first, and scapy's own shell with the script."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dcp_codec.scapy.layers import export_script

pytestmark = pytest.mark.part("tools")

ROOT = Path(__file__).parent.parent.parent
RECORDING = ROOT / "captures" / "b_crud.mcap"


def run(code: str, cwd: Path) -> str:
    """Output of a Python process that runs ``code``; fails the test if its exit status is not 0."""
    done = subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_session(tmp_path: Path) -> None:
    printed = run(
        """
from scapy.all import *
from dcp_codec.scapy.layers import *
use_profile("cpp-2.0")
packet = Ether(src="02:00:00:00:00:01")/DCPBeacon(senderId="02:00:00:00:00:01", networkId=0x1111, seqno=41)/SRPReport(
    nodeId="02:00:00:00:00:01", sData=SafetyData(x=1.5, y=2, z=3))/VarSumm(varId=7, seqno=3)/VarSumm(varId=9)
wrpcap("flight.pcap", [packet] * 3)
found = sniff(offline="flight.pcap", lfilter=lambda p: DCPBeacon in p and p[DCPBeacon].seqno > 40, quiet=True)
print(len(found))
again = rdpcap("flight.pcap")[0]
print(again.summary())
print(again[DCPBeacon].payloads[1].vardis[0].records[1].varId, again.payloads[0].srp.sData.x)
again[DCPBeacon].seqno = 7
again[DCPBeacon].payloads[1].vardis[0].records.append(VarSumm(varId=11, seqno=1))
again[DCPBeacon].clear_derived()
print(Ether(bytes(again)).summary(), again[DCPBeacon].problems)
again.show()
""",
        tmp_path,
    )
    lines = printed.splitlines()
    assert lines[0] == "3"
    assert lines[1] == "Ether / DCP 02:00:00:00:00:01 seqno 41: SRP, VarDis [SUMMARIES 2]"
    assert lines[2] == "9 1.5"
    assert lines[3] == "Ether / DCP 02:00:00:00:00:01 seqno 7: SRP, VarDis [SUMMARIES 3] []"
    for shown in ("###[ DCP beacon ]###", "networkId = 0x1111", "icType    = 1 (SUMMARIES)", "x         = 1.5"):
        assert shown in printed


def test_listing_a_layer(tmp_path: Path) -> None:
    printed = run("from scapy.all import ls\nfrom dcp_codec.scapy.layers import *\nls(DCPBeacon)", tmp_path)
    assert [line.split()[0] for line in printed.splitlines()] == [
        "version",
        "magicNo",
        "senderId",
        "networkId",
        "length",
        "numPayloads",
        "seqno",
        "payloads",
    ]


@pytest.mark.parametrize("name", ["cpp-1.3", "student-2024"])
def test_the_start_up_script(name: str, tmp_path: Path) -> None:
    script = tmp_path / "dcp_session.py"
    script.write_text(export_script(name), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "scapy", "-H", "-c", str(script)],
        input="print([f.name for f in DCPBeacon.fields_desc])\nprint((DCPBeacon()/VarSumm(varId=3)).summary())\n",
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert f"profile {name}" in done.stdout, done.stderr
    assert "'payloads']" in done.stdout
    assert "VarDis [SUMMARIES 1]" in done.stdout


def test_the_script_finds_a_custom_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.toml").write_text('extends = "dcp-2.0"\nname = "mine"\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    script = export_script("mine.toml")
    monkeypatch.chdir("/")
    assert "profile mine" in run(script, Path("/"))


def test_the_codec_does_not_need_scapy(tmp_path: Path) -> None:
    printed = run("import sys, dcp_codec.network.live, dcp_codec; print('scapy' in sys.modules)", tmp_path)
    assert printed == "False\n"
