"""Guide a campaign by code coverage: tests that reach new lines of the target are mutated further.

For Python targets in this process. From Python 3.12 on, the interpreter reports each line once, which costs almost no
time. Earlier versions trace every line, which makes tests about ten times slower.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, Final

from dcp_conformance.errors import UsageError
from dcp_lab.fuzz.campaign import Campaign
from dcp_lab.fuzz.steps import Effect, Step, Target

#: Packages whose lines are counted. The file names of generated decoders contain the name of their package.
_COUNTED: Final = ("dcp_codec", "dcp_stack")
_TOOL: Final = "dcp-fuzz"


class Guide:
    """A target that records the lines it has executed."""

    def __init__(self, target: Target) -> None:
        self.name = target.name
        self._target = target
        self.lines: set[tuple[str, int]] = set()
        """File and number of all executed lines."""
        self.fresh = False
        """Whether the last run executed a new line."""
        self._monitoring: Any = getattr(sys, "monitoring", None)
        if self._monitoring is not None:
            self._monitor()

    def run(self, steps: list[Step]) -> Effect | None:
        """Execute the steps on the wrapped target."""
        self.fresh = False
        if self._monitoring is not None:
            return self._target.run(steps)
        before = sys.gettrace()
        sys.settrace(self._called)
        try:
            return self._target.run(steps)
        finally:
            sys.settrace(before)

    def close(self) -> None:
        """Stop recording lines."""
        if self._monitoring is not None:
            self._monitoring.free_tool_id(self._monitoring.COVERAGE_ID)
            self._monitoring = None

    def _reached(self, file: str, line: int) -> None:
        if (file, line) not in self.lines:
            self.lines.add((file, line))
            self.fresh = True

    # -- Python 3.12 and later ---------------------------------------------------------------------------------

    def _monitor(self) -> None:
        monitoring = self._monitoring
        tool = monitoring.COVERAGE_ID
        try:
            monitoring.use_tool_id(tool, _TOOL)
        except ValueError:
            self._monitoring = None
            raise UsageError("--guided: another tool counts the lines of this process already") from None

        def line(code: CodeType, number: int) -> Any:
            if _is_counted(code.co_filename):
                self._reached(code.co_filename, number)
            return monitoring.DISABLE

        monitoring.register_callback(tool, monitoring.events.LINE, line)
        monitoring.set_events(tool, monitoring.events.LINE)

    # -- earlier versions --------------------------------------------------------------------------------------

    def _called(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:  # noqa: ARG002 - as asked
        return self._traced if _is_counted(frame.f_code.co_filename) else None

    def _traced(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any]:  # noqa: ARG002 - as asked
        if event == "line":
            self._reached(frame.f_code.co_filename, frame.f_lineno)
        return self._traced


def guide(campaign: Campaign) -> Guide:
    """Guide a campaign by the executed lines of its target. The caller must close the returned guide at the end."""
    guided = Guide(campaign.target)
    campaign.target = guided
    campaign.lines = lambda: len(guided.lines)

    def keep(steps: list[Step]) -> None:
        if guided.fresh:
            campaign.generator.keep(steps)

    campaign.after_case = keep
    return guided


def _is_counted(file: str) -> bool:
    return any(name in file for name in _COUNTED)
