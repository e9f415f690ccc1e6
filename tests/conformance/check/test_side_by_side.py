"""The findings of ``check``, its page, and the page of ``dcp-codec report`` make the same statements."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import pytest
from dcp_conformance.check.recording import judge_versions
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import RunResult
from dcp_conformance.reporting.page import render
from dcp_selftest.recordings.lines import recorded
from dcp_tables.report.analysis import time_of
from dcp_tables.report.holding import holding
from dcp_tables.report.recorded import gather

from dcp_codec.analysis.entry import DELETED
from dcp_codec.capture import create_capture

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
#: Name of a recording, and number of its stale states.
RECORDINGS = {"b_crud": 6, "c_latejoin": 1, "line": 0, "line stuck": 3, "line one deletion": 3}


def found(run: RunResult) -> set[tuple[str, int, int]]:
    """Return node, variable and number of each stale state that the findings tell."""
    (case,) = (each for each in run.cases if each.id == "CK_NET_AGREES")
    texts = [each.observed for each in case.checks if each.frames]
    matches = [re.match(r"(\S+) keeps (\d+) of variable (\d+) for ([\d.]+) s ", each) for each in texts]
    return {(each[1], int(each[3]), int(each[2])) for each in matches if each is not None}


@pytest.mark.part("tables")
@pytest.mark.parametrize("what", RECORDINGS)
def test_check_and_pages_agree(tmp_path: Path, what: str):
    path = CAPTURES / f"{what}.mcap"
    if what.startswith("line"):
        path = tmp_path / "line.pcap"
        with create_capture(path) as writer:
            for frame in recorded(what[5:]):
                writer.write(frame)
    ((run, codec),) = judge_versions(path, None, Pics())
    page = html.unescape(render(run, codec))
    # The picture of check: rows with the time from which the state is stale.
    data = json.loads(re.search(r'id="holds-data" hidden>(.*?)</div>', page, re.DOTALL)[1])  # type: ignore[index]
    rows = [row for row in data["changes"] if len(row) > 9 and row[11] >= 0]
    picture = {(data["nodes"][row[1]], data["variables"][row[2]], row[3]) for row in rows}
    # The page of dcp-codec.
    read = gather(str(path), codec.profile.name, None)
    stale = holding(read, time_of(read)).stale
    assert len(rows) == len(stale) == RECORDINGS[what]
    assert picture == {(read.nodes[each.node], each.variable, each.held) for each in stale}
    assert picture >= found(run)
    assert {each[:2] for each in picture} == {each[:2] for each in found(run)}
    # The lags in intervals of 1 ms.
    ages = sorted(row[10] - row[9] for row in rows)
    assert ages == pytest.approx(sorted(each.age * 1000 for each in stale), abs=2)
    assert all(each.missed or each.produced == DELETED for each in stale)
    # The sentences.
    if stale:
        (case,) = (each for each in run.cases if each.id == "CK_NET_AGREES")
        for check in (each for each in case.checks if each.frames):
            assert f"{check.observed}; frames {', '.join(str(mark.frame) for mark in check.frames)}</li>" in page
    else:
        assert "No node has kept a stale value in this recording." in page
