"""A method that a process does not answer is called once, and long cells start first."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from dcp_conformance.errors import NoAnswerError
from dcp_conformance.upper_tester import Answer
from dcp_lab.interop import matrix
from dcp_lab.interop.cell import Cell
from dcp_lab.interop.definition import all_tests
from dcp_lab.interop.implementations import built_in
from dcp_lab.interop.nodes.processes import Station


class Hanging:
    """An upper tester whose RTDB-Read is never answered."""

    methods = frozenset({"RTDB-Read", "RTDB-Update"})

    def __init__(self) -> None:
        self.called: list[str] = []

    def call(self, method: str, params: dict[str, object]) -> Answer:
        self.called.append(method)
        if method == "RTDB-Read":
            raise NoAnswerError("RTDB-Read was not answered within 30 s")
        return Answer("VARDIS-STATUS-OK")

    def poll(self) -> None:
        """There are no notifications."""


def test_a_method_without_an_answer_is_called_once(tmp_path: Path) -> None:
    station = Station(0, "", ["false"], "unix:x", tmp_path / "log", 1.0)
    upper = Hanging()
    station._upper = upper  # type: ignore[assignment]
    station._process = SimpleNamespace(status=lambda: None)  # type: ignore[assignment]
    answers = [station.call("RTDB-Read", {"varId": 1}) for _ in range(3)]
    assert "within 30 s" in answers[0].message
    assert all(each.code == -32603 and "not called again" in each.message for each in answers[1:])
    # Other services may work: a lock of one service is a fault that has been seen.
    assert station.call("RTDB-Update", {"varId": 1}).ok
    assert upper.called == ["RTDB-Read", "RTDB-Update"]


def test_the_short_selection_starts_first_and_long_cells_before_short_ones(monkeypatch) -> None:
    node, started = built_in("node:dcp-2.0"), []

    def executed(cells, *_):
        started.extend(each.test for each in cells)
        yield from ()

    monkeypatch.setattr(matrix, "_executed", executed)
    tests = [name for name, test in all_tests().items() if test.shape.name == "pair"]
    matrix.run_matrix([Cell(a="a", b="b", test=name, implementations=(node, node)) for name in tests])
    order = [(not all_tests()[name].short, -all_tests()[name].longest_s) for name in started]
    assert order == sorted(order)
    assert {short for short, _ in order} == {False, True}
    assert sorted(started) != started
