"""Execute cases side by side against one implementation.

A case waits most of its time, and time passes in one place only: where its bench receives a frame. So each case runs in
a greenlet of its own, and a scheduler hands every frame that arrives to all of them
(:mod:`dcp_conformance.execution.concurrent.scheduler`). What a case
sees of the session is in :mod:`dcp_conformance.execution.concurrent.shared`.
:mod:`dcp_conformance.execution.concurrent.sharing` says which cases need the implementation for themselves, and
:mod:`dcp_conformance.execution.concurrent.executor` executes the others. Only a plain pass counts; whatever else
a case finds side by side is repeated alone, by the ordinary runner, before it is a verdict.
"""

from .executor import WIDTH, execute
from .sharing import why_alone

__all__ = ["WIDTH", "execute", "why_alone"]
