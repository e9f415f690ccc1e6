"""The ``dcp-selftest`` command."""

from __future__ import annotations

from dcp_conformance.errors import ConformanceError

from dcp_codec.common.commandline import CommandLine

main = CommandLine(
    name="dcp-selftest",
    package="dcp_selftest.cli",
    commands={
        "mutants": "Test the suite with faulty nodes, which it must detect.",
        "variants": "Test the suite with permitted nodes, which it must not fail.",
        "model": "Search faulty nodes with the model alone, or draw its sequences.",
        "generated": "Test the suite with random changes of the node's source.",
        "side-by-side": "Compare the verdicts of concurrent cases with those of cases in succession.",
        "vectors": "Test the test vectors with permitted nodes and mutants.",
        "recordings": "Test 'dcp-conformance check' with simulated networks.",
        "interop": "Test 'dcp-conformance interop' with faulty and permitted nodes.",
        "fuzz": "Fuzz the reference node and our own functions in process.",
        "dictionary": "Make the fault dictionary of the diagnosis.",
        "diagnose": "Measure the accuracy of the diagnosis.",
        "smoke-plan": "Measure the durations of the cases, and choose the smoke plan.",
        "citations": "Check that changes of code that cites a requirement are detected.",
        "matrix": "Make the traceability matrix.",
        "provenance": "Compare the catalogue with another version of the specification.",
        "origins": "Make the origins of the requirements from the anchors.",
        "goldens": "Verify or build the recordings of this project.",
    },
    about="Test the DCP conformance kit itself. For those who change the kit.",
    exit_status="0 everything as expected; 1 not; 2 wrong usage; 4 a fault of the tester; 130 interrupted.",
    failures={ConformanceError: 2},
    fault_status=4,
)
