"""Coverage of the target's own code as a guide: what reaches lines that nothing reached before is mutated further.

For targets in Python, in this process. From Python 3.12 on the interpreter tells each line once, which costs next to
nothing; before, every line of a guided case is traced, which makes cases about ten times slower.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, Final

from dcp_conformance.errors import UsageError
from dcp_conformance.fuzz.campaign import Campaign
from dcp_conformance.fuzz.steps import Effect, Step, Target

#: Packages whose lines count. Generated decoders name themselves like the package that makes them.
_COUNTED: Final = ("dcp_codec", "dcp_stack")
_TOOL: Final = "dcp-fuzz"


class Guide:
    """Runs a target and knows which lines it has reached."""

    def __init__(self, target: Target) -> None:
        self.name = target.name
        self._target = target
        self.lines: set[tuple[str, int]] = set()
        """File and line of everything reached."""
        self.fresh = False
        """Whether the last run has reached a line for the first time."""
        self._monitoring: Any = getattr(sys, "monitoring", None)
        if self._monitoring is not None:
            self._monitor()

    def run(self, steps: list[Step]) -> Effect | None:
        """As the target does."""
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
        """Stop counting."""
        if self._monitoring is not None:
            self._monitoring.free_tool_id(self._monitoring.COVERAGE_ID)
            self._monitoring = None

    def _reached(self, file: str, line: int) -> None:
        if (file, line) not in self.lines:
            self.lines.add((file, line))
            self.fresh = True

    # -- since 3.12 --------------------------------------------------------------------------------------------

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

    # -- before ------------------------------------------------------------------------------------------------

    def _called(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:  # noqa: ARG002 - as asked
        return self._traced if _is_counted(frame.f_code.co_filename) else None

    def _traced(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any]:  # noqa: ARG002 - as asked
        if event == "line":
            self._reached(frame.f_code.co_filename, frame.f_lineno)
        return self._traced


def guide(campaign: Campaign) -> Guide:
    """Let the lines of the target guide a campaign; close what is returned when it is done."""
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
