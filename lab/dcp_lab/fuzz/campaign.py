"""One campaign: generate tests, execute them, and minimise findings, up to a limit of time, tests or findings."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from dcp_conformance.errors import UsageError

from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import write_whole
from dcp_lab.testing.mutation import Mutator, Touch

from .findings.artefact import Artefact, SavedTarget, make_artefact, save
from .generate.coverage import Coverage, counter_of, tables
from .reduce.anomalies import anomalies
from .reduce.causes import Cause, cause_of
from .reduce.minimise import Run
from .reduce.reduction import Finding, Reduction
from .steps import Effect, Frame, Generator, Step, Target

STATE_FILE = "campaign.json"
"""File in the folder of artefacts with the state from which ``--resume`` continues."""
#: Kinds of effect that look alike whatever their cause is.
_SILENT = ("dead", "mute")
#: Separator of anomalies that cause a finding only in combination.
_JOINED = " and "
#: Number of findings of one cause after which no frames with its group of anomalies are sent.
_ENOUGH = 3
#: Number of earlier steps that are stored, because a finding may need some of them.
_HISTORY = 4000


class CauseCount(msgspec.Struct):
    """Findings with the same probable cause."""

    title: str
    reaction: str
    findings: int = 0
    smallest: str = ""
    """The artefact with the fewest frames and octets."""
    frames: int = 0
    octets: int = 0
    requirements: tuple[str, ...] = ()


class State(msgspec.Struct):
    """The state of a campaign, as stored in ``campaign.json``."""

    profile: str
    mode: str
    seed: int
    cases: int = 0
    frames: int = 0
    seconds: float = 0.0
    findings: dict[str, str] = {}
    """Artefact by signature of the effect; the signature includes the cause where effects look alike."""
    again: int = 0
    """Number of times that known findings occurred again."""
    causes: dict[str, CauseCount] = {}
    """Findings by probable cause."""
    avoided: list[str] = []
    """Anomalies that cause a finding in a single frame: frames with them are no longer sent."""
    left_out: int = 0
    """Number of frames that were not sent because of ``avoided``."""
    kinds: dict[str, int] = {}
    coverage: Coverage = msgspec.field(default_factory=Coverage)


@dataclass(slots=True)
class Limits:
    """Limits of a campaign, which ends at the first that is reached; None means no limit.

    ``seconds`` is wall-clock time. ``rate``: maximum number of tests a second; it delays tests and ends nothing.
    """

    seconds: float | None = None
    cases: int | None = None
    findings: int | None = None
    rate: float | None = None


@dataclass(slots=True)
class Progress:
    """Progress of a campaign, reported once a second."""

    cases: int
    per_second: float
    findings: int
    seconds: float


@dataclass(slots=True)
class Campaign:
    """Runs tests from a generator on a target."""

    codec: Codec
    target: Target
    generator: Generator
    saved_target: SavedTarget
    seed: int
    directory: Path | None = None
    """Folder for artefacts; None: artefacts are not saved."""
    mutator: Mutator | None = None
    after_case: Callable[[list[Step]], None] | None = None
    """Function that is called with each test after its execution, for guidance by coverage."""
    lines: Callable[[], int] | None = None
    profile_text: str = ""
    budget: int = 600
    """Maximum number of executions to minimise one finding."""
    seconds: float | None = None
    """Maximum time to minimise one finding, in seconds."""
    fresh: Run | None = None
    """Function that executes steps after a restart, for a target that keeps its state between tests."""
    by_cause: bool = False
    """Whether crashes and silences are distinguished by their frames, and such frames are not sent again."""
    aside: Callable[[list[Step], Effect], None] | None = None
    """Function that receives each effect. Without it, effects are minimised and kept at once."""
    on_effect: Callable[[Effect], None] | None = None
    on_progress: Callable[[Progress], None] | None = None
    on_finding: Callable[[Artefact], None] | None = None
    state: State = field(init=False)
    artefacts: list[Artefact] = field(default_factory=list)
    _history: deque[Step] = field(default_factory=lambda: deque(maxlen=_HISTORY))
    """The steps since the last effect."""
    _left: list[Step] | None = None
    """A test that was interrupted by an effect and has to be repeated without the avoided frames."""

    def __post_init__(self) -> None:
        self.state = State(self.codec.profile.name, self.saved_target.mode, self.seed)

    def resume(self) -> None:
        """Continue from the state in the folder.

        Raises :class:`UsageError` if there is none, or if it is of a campaign with another profile or mode.
        """
        if self.directory is None:
            raise UsageError("--resume needs the folder of the campaign: --artefacts DIR")
        self.state = read_state(self.directory)
        if (self.state.profile, self.state.mode) != (self.codec.profile.name, self.saved_target.mode):
            of = f"{self.state.mode} with the profile {self.state.profile}"
            raise UsageError(f"{self.directory}: the campaign in it is of {of}")
        self.has_reached(self.state.coverage)

    def has_reached(self, coverage: Coverage) -> None:
        """Add the coverage of other campaigns, or of earlier parts of this one."""
        if self.mutator is not None:
            self.mutator.reached.update(counter_of(coverage.fields))

    def run(self, limits: Limits) -> State:
        """Run until a limit is reached, and save the state, also after Ctrl-C. Forwards exceptions of the target."""
        begun, done_before = time.monotonic(), self.state.seconds
        try:
            self.carry_out(limits)
        finally:
            self.state.seconds = done_before + time.monotonic() - begun
            self.close()
        return self.state

    def carry_out(self, limits: Limits) -> None:
        """Execute tests until a limit is reached, without saving the state."""
        begun = told = time.monotonic()
        state, first = self.state, self.state.cases
        while not self._over(limits, begun, first):
            steps = self._drawn()
            effect = self.target.run(steps)
            state.cases += 1
            for kind in self.generator.kinds:
                state.kinds[kind] = state.kinds.get(kind, 0) + 1
            state.frames += sum(1 for step in steps if type(step) is Frame)
            if self.after_case is not None:
                self.after_case(steps)
            if effect is not None:
                avoided = len(state.avoided)
                self._seen(steps, effect)
                self._history.clear()
                # The steps after the effect were not sent, or not received.
                self._left = steps if len(state.avoided) > avoided else None
            elif self.fresh is not None:
                self._history.extend(steps)
            now = time.monotonic()
            if limits.rate is not None:
                ahead = begun + (state.cases - first) / limits.rate - now
                if ahead > 0:
                    time.sleep(ahead)
            if self.on_progress is not None and now - told >= 1:
                told = now
                seconds = now - begun
                per_second = (state.cases - first) / seconds
                self.on_progress(Progress(state.cases, per_second, len(state.findings), seconds))

    def close(self) -> None:
        """Compute the coverage and save the state. Raises :class:`UsageError` if it cannot be written."""
        self.state.coverage = self.coverage()
        if self.directory is not None:
            write_state(self.state, self.directory)

    def coverage(self) -> Coverage:
        """Return the coverage so far."""
        fields: Counter[Touch] = self.mutator.reached if self.mutator is not None else Counter()
        possible = self.mutator.possible if self.mutator is not None else frozenset[Touch]()
        return tables(fields, possible, self.lines() if self.lines is not None else 0)

    def _over(self, limits: Limits, begun: float, first: int) -> bool:
        if limits.seconds is not None and time.monotonic() - begun >= limits.seconds:
            return True
        if limits.cases is not None and self.state.cases - first >= limits.cases:
            return True
        return limits.findings is not None and len(self.artefacts) >= limits.findings

    def _seen(self, steps: list[Step], effect: Effect) -> None:
        """Process an effect: count a known one, minimise and keep a new one."""
        if self.aside is not None:
            self.aside(steps, effect)
        elif effect.signature in self.state.findings:
            self.state.again += 1
        else:
            self._found(steps, effect)

    def _found(self, steps: list[Step], effect: Effect) -> None:
        """Minimise and keep a finding. If the minimisation is interrupted, keep its best result so far."""
        reduction = self.reduction(effect)
        try:
            if self.on_effect is not None:
                self.on_effect(effect)
            reduction.reduce(steps, effect, [*self._history])
        finally:
            # Also if the implementation cannot be restarted, or the user presses Ctrl-C.
            found = reduction.outcome(steps, effect)
            if found.minimised and self._is_known(found.steps, found.effect):
                self.state.again += 1
            else:
                self.keep(found)

    def reduction(self, effect: Effect) -> Reduction:
        """Return the minimiser for an effect of this target."""
        return Reduction(
            self.target.run,
            None if self.saved_target.mode == "codec" else self.codec,
            fresh=self.fresh,
            budget=self.budget,
            seconds=self.seconds,
            known=self._is_known if self.by_cause and effect.kind in _SILENT else None,
        )

    def keep(self, found: Finding) -> None:
        """Save a finding as an artefact and register it as known. Raises :class:`UsageError` if it cannot be saved."""
        artefact = make_artefact(
            self.codec,
            found,
            self.saved_target,
            seed=self.seed,
            directory=self.directory or Path(),
            profile_text=self.profile_text,
        )
        self.state.findings[self._key(found.steps, found.effect)] = artefact.id
        self.artefacts.append(artefact)
        if found.cause is not None:
            self._count(artefact, found.cause)
            self._avoid(found, found.cause)
        if self.directory is not None:
            save(artefact, self.directory)
        if self.on_finding is not None:
            self.on_finding(artefact)

    def _count(self, artefact: Artefact, cause: Cause) -> None:
        counted = self.state.causes.setdefault(
            cause.group, CauseCount(cause.title, cause.reaction, requirements=cause.requirements)
        )
        counted.findings += 1
        size = artefact.frames, artefact.octets
        if not counted.smallest or size < (counted.frames, counted.octets):
            counted.smallest, (counted.frames, counted.octets), counted.title = artefact.id, size, cause.title

    def _avoid(self, found: Finding, cause: Cause) -> None:
        """Register the anomalies of a finding of a single frame, so that such frames are no longer sent."""
        frames = [step for step in found.steps if isinstance(step, Frame)]
        alone = len(frames) == len(found.steps) == 1
        if not (self.by_cause and found.confirmed and alone and found.effect.kind in _SILENT):
            return
        odd = anomalies(self.codec, frames[0].octets)
        if odd:
            self.state.avoided.append(_JOINED.join(dict.fromkeys(each.kind for each in odd)))
        if len({each.group for each in odd}) == 1 and self.state.causes[cause.group].findings == _ENOUGH:
            self.state.avoided.append(odd[0].group)

    # -- distinguishing findings -------------------------------------------------------------------------------

    def _key(self, steps: list[Step], effect: Effect) -> str:
        """Return the key of a finding: the signature, and the cause for crashes and silences, which look alike."""
        if not (self.by_cause and effect.kind in _SILENT):
            return effect.signature
        return f"{effect.signature} by {cause_of(self.codec, steps)}"

    def _is_known(self, steps: list[Step], effect: Effect) -> bool:
        return self._key(steps, effect) in self.state.findings

    def _drawn(self) -> list[Step]:
        """Return the next test, without frames that would cause a known finding."""
        steps, self._left = self._left or self.generator.draw(), None
        if not self.state.avoided:
            return steps
        avoided = [set(each.split(_JOINED)) for each in self.state.avoided]
        kept = [step for step in steps if not isinstance(step, Frame) or not self._has(step.octets, avoided)]
        self.state.left_out += len(steps) - len(kept)
        return kept

    def _has(self, octets: bytes, avoided: list[set[str]]) -> bool:
        """Return whether a frame has all anomalies of one of the findings."""
        found = anomalies(self.codec, octets)
        names = {each.kind for each in found} | {each.group for each in found}
        return any(each <= names for each in avoided)


def read_state(directory: Path) -> State:
    """Read the state of the campaign in a folder. Raises :class:`UsageError` if there is none or it is damaged."""
    path = directory / STATE_FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=State)
    except OSError as error:
        raise UsageError(f"{path}: there is no campaign to resume: {error.strerror or error}") from None
    except msgspec.DecodeError as error:
        raise UsageError(f"{path}: {error}") from None


def write_state(state: State, directory: Path) -> None:
    """Write the state of a campaign into its folder. Raises :class:`UsageError` if that fails."""
    path = directory / STATE_FILE
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_whole(path, msgspec.json.format(msgspec.json.encode(state), indent=1) + b"\n")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None
