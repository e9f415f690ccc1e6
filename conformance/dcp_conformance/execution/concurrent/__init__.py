"""Execute cases side by side (concurrently) against one implementation.

A case spends most of its time waiting, and it waits in one place only: where its bench receives a frame. So each case
runs in a separate greenlet, and a scheduler delivers every received frame to all of them
(:mod:`dcp_conformance.execution.concurrent.scheduler`). :mod:`dcp_conformance.execution.concurrent.shared` has the view
of the session that a case gets. :mod:`dcp_conformance.execution.concurrent.sharing` lists the cases that must be
executed alone, and :mod:`dcp_conformance.execution.concurrent.executor` executes the others. Only an undisturbed pass
counts; a case with any other verdict is repeated alone by the ordinary runner.
"""

from .executor import WIDTH, execute
from .sharing import why_alone

__all__ = ["WIDTH", "execute", "why_alone"]
