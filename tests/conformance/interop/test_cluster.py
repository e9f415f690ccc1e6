"""Cells by the workers of a Dask cluster: one in this process, which is the same to the runner."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from dcp_conformance.errors import UsageError
from dcp_conformance.interop.definition import all_tests
from dcp_conformance.interop.implementations import resolve
from dcp_conformance.interop.matrix import cells_of, run_matrix
from dcp_conformance.model.verdict import Verdict

NAMES = ("node:dcp-2.0", "mutant:M-VD-PU-07-ignored")
TESTS = ("IT_VD_CREATE-pair", "IT_VD_UPDATE-pair")


@pytest.fixture
def scheduler() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.part("tools")
def test_a_cluster_gives_the_same_verdicts_as_this_machine(scheduler: str) -> None:
    cells = cells_of(resolve(NAMES, {}), [all_tests()[name] for name in TESTS])
    ours, theirs = run_matrix(cells, seeds=2, jobs=1), run_matrix(cells, seeds=2, dask=scheduler)
    assert [cell.verdict for cell in theirs.cells].count(Verdict.FAIL) == 2
    for one, two in zip(ours.cells, theirs.cells, strict=True):
        assert (one.a, one.b, one.test, one.verdict, one.reason) == (two.a, two.b, two.test, two.verdict, two.reason)


@pytest.mark.part("suite")
def test_an_interruption_keeps_what_the_cluster_has_finished(scheduler: str) -> None:
    cells = cells_of(resolve(NAMES, {}), [all_tests()[name] for name in TESTS])

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    found = run_matrix(cells, dask=scheduler, on_cell=interrupt)
    assert found.ended_early == "interrupted"
    assert len(found.cells) == 1
    assert found.unfinished == len(cells) - 1


@pytest.mark.parametrize("address", ["nonsense://x", "tcp://127.0.0.1:x"])
def test_a_scheduler_that_cannot_be_reached_is_named(address: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(UsageError, match=f"--dask {address}: the scheduler cannot be reached"):
        run_matrix(cells_of(resolve(NAMES[:1], {}), [all_tests()[TESTS[0]]]), dask=address)
