"""Node identifiers that people and upper testers write: read in one way, and refused in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Session

from dcp_codec.cli.common import UNUSABLE

from ..command import Command
from ..rig import codec_of

OURS = bytes.fromhex("020000000001")
RIGHT = "such as 02:00:00:00:00:01 or 020000000001"


@pytest.mark.parametrize("text", ["02:00:00:00:00:01", "020000000001", "02:00:00:00:00:01".upper()])
def test_valid_node_identifiers(text: str):
    assert node_id_octets(text) == OURS


@pytest.mark.parametrize("text", ["", ":", "drone1", "02-00-00-00-00-01", "0:1", "02::01", "02:0000:1", "02 00", "٠١"])
def test_invalid_node_identifiers(text: str):
    with pytest.raises(ValueError, match="is not a node identifier") as refused:
        node_id_octets(text)
    assert repr(text) in str(refused.value)
    assert RIGHT in str(refused.value)


@pytest.mark.parametrize(
    ("node_id", "what"),
    [("drone1", RIGHT), ("", RIGHT), ("02:00:00:00:01", "it has 5 octets, in the profile dcp-2.0 it has 6")],
)
def test_an_invalid_identifier_in_a_file_is_a_usage_error(
    dcp_conformance: Command, tmp_path: Path, node_id: str, what: str
):
    pics = tmp_path / "pics.toml"
    pics.write_text(f'[pixit]\nnode_id = "{node_id}"\n', encoding="utf-8")
    ended = dcp_conformance("run", "--in-process", "TC_DCP_SANITY_BV_01", "--pics", pics)
    assert ended.status == UNUSABLE
    for each in (str(pics), "pixit", "node_id", repr(node_id), what):
        assert each in ended.err
    assert len(ended.err.splitlines()) == 1


def test_a_valid_identifier_in_a_file(dcp_conformance: Command, tmp_path: Path):
    pics = tmp_path / "pics.toml"
    pics.write_text('[pixit]\nnode_id = "020000000001"\n', encoding="utf-8")
    ended = dcp_conformance("run", "--in-process", "TC_DCP_SANITY_BV_01", "--pics", pics)
    assert ended.status == 0, ended.err


def test_an_invalid_identifier_on_the_command_line(dcp_conformance: Command, tmp_path: Path):
    ended = dcp_conformance("replay", tmp_path / "none.mcap", "--node", "drone1")
    assert ended.status == UNUSABLE
    for each in ("--node", "'drone1'", RIGHT):
        assert each in ended.err


class Misnamed(VirtualUpperTester):
    """Says a name that is not an identifier."""

    def call(self, method: str, params: dict[str, Any]) -> Any:
        answer = super().call(method, params)
        if method == "UT-Hello":
            answer.result["nodeId"] = "drone1"
        return answer


def test_an_invalid_identifier_of_an_upper_tester_is_its_fault():
    codec = codec_of("dcp-2.0")
    sut = InProcess(reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), Misnamed(sut), Pics()), sut)
    with pytest.raises(UpperTesterError, match=r"UT-Hello.*'drone1' is not a node identifier"):
        runner.prepare()
