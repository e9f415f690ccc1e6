"""Implementations that lose a container of a payload: they fail the requirements of extraction, and no others."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.interconnection.extraction import OWNERS

from dcp_codec.errors import DecodeError
from dcp_stack.vardis.wire import Extracted, Extractor

from ..rig import every_case, known_cases
from ..slow import runner_for
from ..suite.test_vardis_reception_mutants import make_with


class LosesContainers(Extractor):
    """Refuses bad payloads as any other, and loses containers of good ones."""

    def extract(self, payload: bytes) -> Extracted:
        try:
            containers = self._codec.decode_containers(payload)
        except DecodeError:
            return super().extract(payload)
        sizes = [len(self._codec.encode_containers((each,))) for each in containers]
        starts = [sum(sizes[:number]) for number in range(len(sizes))]
        kept = [each for each, start in zip(containers, starts, strict=True) if self.keeps(start, len(payload))]
        return super().extract(self._codec.encode_containers(kept))

    def keeps(self, start: int, size: int) -> bool:
        raise NotImplementedError


class UntilTheMiddle(LosesContainers):
    """Compares what was read with what is left, not with what there was."""

    def keeps(self, start: int, size: int) -> bool:
        return start < size - start


class FirstOnly(LosesContainers):
    def keeps(self, start: int, size: int) -> bool:
        return start == 0


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.0"])
@pytest.mark.parametrize("extractor", [UntilTheMiddle, FirstOnly])
def test_only_the_requirements_of_extraction_fail(extractor: type[Extractor], profile: str) -> None:
    runner = runner_for(profile, make=make_with(extractor))
    failed: set[str] = set()
    for each in every_case():
        if each.id in (DECLARED, DENIED):
            continue
        result = runner.run(each)
        checks = [check for check in result.checks if check.verdict is Verdict.FAIL]
        failed.update(requirement for check in checks for requirement in check.requirements)
        assert failed <= OWNERS, (each.id, result.reason)
    assert runner.session.known.lost_container == "second"
    assert failed >= {"VD-RX-02", "VD-RX-04"}


def test_lost_containers_are_reported() -> None:
    runner = runner_for(make=make_with(UntilTheMiddle))
    assert runner.run(known_cases()["TC_DCP_SANITY_BV_01"]).verdict is Verdict.PASS
    result = runner.run(known_cases()["TC_VD_ROOM_BV_01-a-VarDelete"])
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "it loses the second of two containers in a payload (VD-RX-04)" in result.reason


def test_a_conforming_node_loses_nothing() -> None:
    runner = runner_for()
    runner.run(known_cases()["TC_DCP_SANITY_BV_01"])
    assert runner.session.known.lost_container == ""
