"""Search for counterexamples of the model, and repeat them: in virtual time, or on an implementation on a link."""

from __future__ import annotations

import atexit
import contextlib
import functools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

from dcp_conformance.errors import UsageError
from dcp_conformance.execution.target import Target as Opened
from dcp_conformance.execution.target import TargetOptions, describe, open_target, say_contradictions
from dcp_conformance.reference.inprocess import reference_config
from dcp_conformance.stateful.driver import Counterexample, Driver, shorter
from dcp_conformance.stateful.executor import Executor
from dcp_conformance.stateful.judged import ATTEMPTS, execute
from dcp_conformance.stateful.machine import NodeMachine
from dcp_conformance.stateful.on_bench import BenchExecutor
from dcp_conformance.stateful.search import Found, search
from dcp_conformance.stateful.steps import Step
from dcp_conformance.stateful.virtual import VirtualExecutor
from dcp_conformance.test_system.bench import Bench
from hypothesis import HealthCheck, Phase, settings

from dcp_codec.codec import get_codec
from dcp_codec.common.commandline import say
from dcp_lab.fuzz.findings.artefact import save
from dcp_lab.fuzz.findings.counterexample import artefact_of, effect_of
from dcp_lab.fuzz.steps import Effect

from .live import LiveTarget, NotAliveError

#: Services of BP that are not about a client protocol.
_BP: Final = ("BP-MGMT-Activate", "BP-MGMT-Deactivate", "BP-ListRegisteredProtocols", "BP-SetParameter")


class ModelTarget:
    """An implementation on which a counterexample is repeated."""

    def __init__(self, opened: Opened | None, profile: str, steps: Sequence[Step], *, in_process: bool) -> None:
        """``opened``: the implementation; None, or ``in_process``: the reference node in virtual time."""
        self.name = "our own node in this process" if opened is None or in_process else "the implementation"
        self._profile = profile
        self._steps = steps
        self._live = LiveTarget(opened) if opened is not None and not in_process else None

    def run(self, steps: list[Any]) -> Effect | None:  # noqa: ARG002 - the steps are those of the counterexample
        """Execute the steps from the initial state; see :class:`~dcp_lab.fuzz.steps.Target`."""
        if self._live is not None:
            found = execute(self._live.prepare(), self._steps, alone=True)
            return None if found is None else effect_of(found)
        try:
            Driver(VirtualExecutor(reference_config(get_codec(self._profile)))).run(self._steps)
        except Counterexample as error:
            return effect_of(error)
        return None


def run_search(
    where: TargetOptions,
    words: str,
    *,
    sequences: int,
    steps: int,
    database: str,
    coverage: bool,
    directory: Path | None,
) -> int:
    """Search, show the result, and return the exit status. ``words``: the options that reach the implementation."""
    say(f"drawing up to {sequences} sequences of {steps} steps with seed {where.seed}")
    if where.in_process:
        codec, _ = describe(where)
        config = reference_config(codec)
        found = search(
            lambda: VirtualExecutor(config, seed=where.seed),
            sequences=sequences, steps=steps, seed=where.seed, database=database,
        )  # fmt: skip
        return _told(found, codec.profile.name, "our own node in this process", words, where.seed, coverage, directory)
    with open_target(where) as opened:
        opened.runner.prepare()
        say_contradictions(opened.runner, functools.partial(say, err=True))
        live = LiveTarget(opened)
        try:
            live.prepare()
        except NotAliveError as error:
            say(f"dcp-conformance: {error}", err=True)
            return 3
        found = _live(live, sequences=sequences, steps=steps, seed=where.seed, database=database)
        return _told(found, opened.codec.profile.name, live.name, words, where.seed, coverage, directory)


class OnLink(NodeMachine):
    """Draws sequences for an implementation on a link, which is brought into its initial state before each of them."""

    live: ClassVar[LiveTarget]
    _benches: ClassVar[list[Bench]] = []

    def open(self) -> Executor:
        """Return the implementation in its initial state."""
        self._benches.append(self.live.prepare())
        return BenchExecutor(self._benches[-1], alone=True)

    def close(self, executor: Executor) -> None:
        """Undo what the sequence has changed."""
        del executor
        self._benches.pop().restoration.restore()


def machine_for(options: TargetOptions, *, sequences: int = 20, steps: int = 12) -> type[OnLink]:
    """Return a state machine for the tests of an implementer: ``TestNode = machine_for(...).TestCase``.

    ``options`` are those of ``dcp-conformance run``. The implementation is opened when the first sequence begins.
    """

    class Node(OnLink):
        _stack: ClassVar[contextlib.ExitStack] = contextlib.ExitStack()

        def open(self) -> Executor:
            if not hasattr(Node, "live"):
                opened = self._stack.enter_context(open_target(options))
                atexit.register(self._stack.close)
                opened.runner.prepare()
                Node.live = LiveTarget(opened)
            return super().open()

    Node.TestCase.settings = settings(
        max_examples=sequences,
        stateful_step_count=steps,
        deadline=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    return Node


def _live(live: LiveTarget, **limits: Any) -> Found:
    """Search on a link. Hypothesis would shrink for minutes: steps are left out one by one instead."""
    OnLink.live = live
    found = search(None, shrink=False, machine=OnLink, **limits)
    if found.counterexample is not None:
        found.counterexample = shorter(
            lambda steps: execute(live.prepare(), steps, alone=True), found.counterexample, attempts=ATTEMPTS
        )
    return found


def _told(found: Found, profile: str, name: str, words: str, seed: int, coverage: bool, directory: Path | None) -> int:
    """Show the result of a search; return the exit status."""
    pairs = sum(1 for _ in found.reached)
    say(f"{found.sequences} sequences, {found.steps} steps, {pairs} pairs of state and event")
    if coverage:
        for (state, event), count in sorted(found.reached.items(), key=lambda each: (each[1], each[0])):
            say(f"{count:7}  {state}: {event}")
        for state, event in sorted(never_reached(found.reached)):
            say(f"      -  {state}: {event}")
    if found.counterexample is None:
        say(f"no counterexample{' that was seen twice' if found.flaky else ''}")
        return 0
    for line in str(found.counterexample).splitlines():
        say(line)
    if directory is not None:
        artefact = artefact_of(found.counterexample, profile, name=name, options=words, seed=seed, directory=directory)
        try:
            say(f"saved as {save(artefact, directory)}; repeat: {artefact.command}")
        except OSError as error:
            raise UsageError(f"{directory}: {error}") from None
    return 1


def never_reached(reached: Counter[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the pairs of a reached state and an event of the same kind that did not occur together."""
    kinds: dict[str, tuple[set[str], set[str]]] = {}
    for state, event in reached:
        states, events = kinds.setdefault(_kind(event), (set(), set()))
        states.add(state)
        events.add(event)
    every = {(state, event) for states, events in kinds.values() for state in states for event in events}
    return every - set(reached)


def _kind(event: str) -> str:
    """Return what an event is about."""
    name = event.partition(",")[0]
    if name.startswith("BP-"):
        return "BP" if name in _BP else "client"
    if name in ("payload", "report") or name.startswith(("RTDB-Describe", "VD-", "SRP-")):
        return name
    return "RTDB" if name.startswith("RTDB") else "records"
