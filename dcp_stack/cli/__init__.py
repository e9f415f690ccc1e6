"""The ``dcp-node`` command."""

from __future__ import annotations

from dcp_codec.common.commandline import UNUSABLE, CommandLine, CommandSection
from dcp_stack.runtime.errors import NodeError

#: Entry point of ``dcp-node``.
main = CommandLine(
    name="dcp-node",
    package="dcp_stack.cli",
    commands={
        "run": "Run a node on an interface or over UDP.",
        "wait": "Wait until a node answers at its control socket.",
        "stop": "End a node.",
        "status": "Show the state of a node.",
        "monitor": "Watch a node: neighbours, variables, rates, drops.",
        "neighbours": "Show the neighbour table.",
        "var": "Create, update, read, delete, list and watch variables.",
        "bp": "Register client protocols, send and watch their payloads.",
        "param": "Get and set the parameters of BP, SRP and VarDis.",
        "activate": "Activate BP and VarDis.",
        "deactivate": "Deactivate BP and VarDis.",
        "reset": "Restore the state of a node after its start.",
    },
    further=(
        CommandSection(
            "Commands of dcp-conformance-lab",
            "dcp_lab.cli",
            {
                "simulate": "Run a network of nodes in virtual time.",
                "sweep": "Run a scenario for all combinations of some values, and for several seeds.",
                "explore": "Visit all states of a small network, and find what goes wrong.",
                "testbed": "Run nodes in network namespaces on a virtual Ethernet.",
            },
        ),
    ),
    about="Run a DCP node (Drone Coordination Protocol), and control a running one.",
    exit_status="0 OK; 1 a service answered with a status other than OK; 2 wrong usage, or an invalid "
    "configuration, link or request; 3 no node could be reached.",
    failures={NodeError: UNUSABLE},
)
