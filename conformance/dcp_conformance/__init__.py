"""The conformance suite: test cases, verdicts, results and ``dcp-conformance``.

The names below are the public interface (docs/stability.md). Read the results of a run::

    >>> from pathlib import Path
    >>> from dcp_conformance import Verdict, load_results
    >>> run = load_results(Path("report"))         # the folder of a report, or its results.json
    >>> [case.id for case in run.cases if case.verdict is Verdict.FAIL]

The decorator :func:`case` turns a function into a test case. docs/dcp-conformance.md and the modules of
:mod:`dcp_conformance.suite` show how to write test cases.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .definitions.case import Case, Needs, Variant, case
    from .definitions.pics import Capabilities, Pics, Testing, load_pics
    from .definitions.results import CaseResult, Check, RunResult
    from .definitions.verdict import Verdict, worst
    from .errors import ConformanceError, UsageError
    from .reporting.files import load_results, write_report

__all__ = [
    "Capabilities",
    "Case",
    "CaseResult",
    "Check",
    "ConformanceError",
    "Needs",
    "Pics",
    "RunResult",
    "Testing",
    "UsageError",
    "Variant",
    "Verdict",
    "case",
    "load_pics",
    "load_results",
    "worst",
    "write_report",
]

# Lazy imports: reading results loads neither the suite nor the node.
__getattr__ = exported(
    __name__,
    {
        "errors": ("ConformanceError", "UsageError"),
        "definitions.case": ("Case", "Needs", "Variant", "case"),
        "definitions.pics": ("Capabilities", "Pics", "Testing", "load_pics"),
        "definitions.results": ("CaseResult", "Check", "RunResult"),
        "definitions.verdict": ("Verdict", "worst"),
        "reporting.files": ("load_results", "write_report"),
    },
)
