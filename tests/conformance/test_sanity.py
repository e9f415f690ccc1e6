"""The sanity case says what may be the matter with an implementation that does not answer."""

from __future__ import annotations

import msgspec
from dcp_conformance.bench import Session
from dcp_conformance.case import SANITY
from dcp_conformance.pics import Pics
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.results import CaseResult
from dcp_conformance.runner import Runner
from dcp_conformance.verdict import Verdict

from .rig import codec_of, known_cases


def sanity(sut: InProcess, profile: str, *, upper: bool = False) -> CaseResult:
    """The sanity case with the tester speaking ``profile``."""
    session = Session(codec_of(profile), sut.lower_tester(), sut.upper_tester() if upper else None, Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner.run(known_cases()[SANITY])


def talking(profile: str) -> InProcess:
    """A node with something to say."""
    sut = InProcess(reference_config(codec_of(profile)))
    params = {"varId": 1, "repCnt": 3, "descr": "battery", "value": "01"}
    assert sut.upper_tester().call("RTDB-Create", params).ok
    return sut


def test_it_speaks_another_profile():
    result = sanity(talking("cpp-1.3"), "dcp-2.0")
    assert result.verdict is Verdict.FAIL
    assert "its frames look like cpp-1.3 (" in result.reason
    assert result.reason.endswith("try --profile cpp-1.3")


def test_it_is_silent():
    # A node that hears nothing of what the tester says, and has nothing to say itself.
    result = sanity(InProcess(reference_config(codec_of("cpp-1.3"))), "sim-1.0")
    assert result.verdict is Verdict.FAIL
    assert "nothing was heard: is it running, on this link" in result.reason


def test_it_does_not_answer():
    config = msgspec.structs.replace(reference_config(codec_of("dcp-2.0")), vardis=None)
    sut = InProcess(config)
    data = {"x": 1, "y": 2, "z": 3}
    assert sut.upper_tester().call("SRP-UpdateSafetyData", {"sData": data}).ok
    result = sanity(sut, "dcp-2.0")
    assert result.verdict is Verdict.FAIL
    assert "is this its network identifier, and does it have VarDis?" in result.reason


def test_all_is_well():
    result = sanity(talking("dcp-2.0"), "dcp-2.0", upper=True)
    assert (result.verdict, result.reason) == (Verdict.PASS, "")
