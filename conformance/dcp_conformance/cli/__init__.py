"""The ``dcp-conformance`` command."""

from __future__ import annotations

from dcp_codec.common.commandline import CommandLine, CommandSection
from dcp_conformance.errors import ConformanceError, LowerTesterError, UpperTesterError

#: Exit status by exception: failures of the link or the upper tester are the tester's trouble, others wrong usage.
_FAILURES: dict[type[Exception], int] = {LowerTesterError: 4, UpperTesterError: 4, ConformanceError: 2}

main = CommandLine(
    name="dcp-conformance",
    package="dcp_conformance.cli",
    commands={
        "run": "Test an implementation.",
        "list": "Show the test cases.",
        "probe": "Draft the PICS of an implementation by observation and queries.",
        "check": "Judge recordings of a network.",
        "why": "Tell why a node holds the value that it holds.",
        "replay": "Replay a recording to an implementation.",
        "report": "Generate the page of a run again, or compare several runs in one table.",
        "compare": "Show which verdicts differ between two runs.",
        "vectors": "Write test vectors for unit tests in any language.",
    },
    further=(
        CommandSection(
            "Commands of dcp-conformance-lab",
            "dcp_lab.cli",
            {
                "fuzz": "Find inputs that break an implementation.",
                "interop": "Test networks of several implementations.",
            },
        ),
    ),
    about="Test implementations of DCP (Drone Coordination Protocol), live or from recordings.",
    exit_status="0 everything as expected; 1 an unexpected fail or pass; 2 wrong usage, or nothing to run; 3 nothing "
    "unexpected, but something inconclusive; 4 a fault of the tester; 130 interrupted.",
    failures=_FAILURES,
    fault_status=4,
)
