"""One cell of the matrix: one network test with two implementations in one world, and its verdict."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import msgspec
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict, worst
from dcp_conformance.errors import ConformanceError
from dcp_conformance.execution.case_results import doubted
from dcp_conformance.execution.runner import CONFIRMATIONS

from dcp_codec.codec import get_codec
from dcp_codec.common.commandline import say
from dcp_codec.common.signals import Stop

from .definition import NetworkTest
from .implementations import Implementation, meeting_profile, virtual_setup
from .judge import deaths, rules
from .results import CellResult, StationResult
from .scene import NotApplicableError, Scene, StopError
from .world import World, node_text

WorldKind = Literal["virtual", "real"]


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """The implementations, test and seed of a cell."""

    a: str
    b: str
    test: str
    implementations: tuple[Implementation, Implementation]
    """Of role A and of role B."""
    world: WorldKind = "virtual"
    seed: int = 1

    @property
    def name(self) -> str:
        """``A:B:TEST``, as ``--only`` has it."""
        return f"{self.a}:{self.b}:{self.test}"


def obstacle(test: NetworkTest, a: Implementation, b: Implementation, world: WorldKind) -> str:
    """Why a test does not apply to a pair of implementations; empty if it does."""
    meeting = meeting_profile(a, b)
    if test.wire == "same" and meeting is None:
        return "the implementations have no version of the wire format and network in common"
    if test.wire == "different" and meeting is not None:
        return f"the implementations share a version ({meeting}); the test is about different ones"
    if test.wire == "different" and set(a.profiles) & set(b.profiles):
        return "the implementations differ within one version, which beacons do not tell apart"
    if world == "real" and test.virtual_only:
        return f"needs virtual time: {test.virtual_only}"
    for each in (a, b):
        for entity in test.entities:
            profile = get_codec(each.profile).profile
            if not getattr(each, entity) or (entity == "srp" and not profile.srp.is_report):
                return f"an implementation has no {entity}"
        version = get_codec(meeting or each.profile).profile.spec_version
        if not test.since <= version <= test.until:
            return f"the test is about versions {test.since} to {test.until}, not {version}"
    return ""


def run_cell(cell: Cell, test: NetworkTest, folder: Path | None = None, stop: Stop | None = None) -> CellResult:
    """Run a cell. ``folder``: for recordings and logs.

    A failure on a machine that was too busy counts only if it recurs in each of some further executions.

    ``stop``: the handler of signals, which then interrupt the test only, and not the making or removal of its network.
    Raises ``KeyboardInterrupt`` after the removal.
    """
    began = time.perf_counter()
    a, b = cell.implementations
    profile = meeting_profile(a, b) or a.profile
    reason = obstacle(test, a, b, cell.world)
    if reason:
        return _result(cell, test, profile, Verdict.NOT_APPLICABLE, reason)
    result, late = _run_once(cell, test, profile, folder, stop)
    died = any(station.death for station in result.stations)
    for number in range(1, CONFIRMATIONS + 1):
        if result.verdict is not Verdict.FAIL or not late or died:
            break
        again, _ = _run_once(cell, test, profile, None, stop)
        if not _failed(result) & _failed(again):
            checks = [doubted(each, number, late) for each in result.checks]
            verdict = worst(check.verdict for check in checks) or Verdict.INCONCLUSIVE
            result = msgspec.structs.replace(
                result, checks=tuple(checks), verdict=verdict, reason=_reason(checks, verdict)
            )
    return msgspec.structs.replace(result, elapsed_s=round(time.perf_counter() - began, 3))


def _failed(result: CellResult) -> set[str]:
    """Return the requirements of the failed checks."""
    return {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}


def _run_once(
    cell: Cell, test: NetworkTest, profile: str, folder: Path | None, stop: Stop | None
) -> tuple[CellResult, str]:
    """Run a cell once; return its result, and why the machine may have been too busy (empty if it was not)."""
    # Not before: most cells of a large matrix do not apply.
    try:
        world = _world(cell, test)
    except ConformanceError as error:
        return _result(cell, test, profile, Verdict.ERROR, str(error)), ""
    try:
        with nullcontext() if stop is None else stop.interruptible_by_signals():
            result = _play(cell, test, world, profile)
        if folder is not None:
            from .recording import write_recordings

            result = write_recordings(result, world, folder)
        return result, world.lateness
    finally:
        world.close()


def _world(cell: Cell, test: NetworkTest) -> World:
    roles = {"A": (cell.a, cell.implementations[0]), "B": (cell.b, cell.implementations[1])}
    common = meeting_profile(*cell.implementations)
    chosen = (roles[role] for role in test.shape.roles)
    stations = [(name, each, common or each.profile) for name, each in chosen]
    if cell.world == "virtual":
        from .nodes.virtual import VirtualWorld

        made = [(name, *virtual_setup(each, profile)) for name, each, profile in stations]
        return VirtualWorld(made, test.shape, cell.seed)
    from .nodes.real import RealWorld

    def on_wait(text: str) -> None:
        say(f"{cell.a} with {cell.b}: {test.id}: {text}", err=True)

    return RealWorld(stations, test.shape, cell.seed, on_wait=on_wait)


def _play(cell: Cell, test: NetworkTest, world: World, profile: str) -> CellResult:
    scene = Scene(world, test.shape, test.requirements, cell.seed)
    skipped = detail = ""
    checks: list[Check] = []
    try:
        test.run(scene)
        # A process can end between two looks.
        scene.wait(0)
    except NotApplicableError as missing:
        skipped = str(missing)
    except StopError:
        pass
    except ConformanceError as error:
        checks.append(Check(Verdict.ERROR, test.requirements, "the tester can run the test", str(error)))
    except Exception as error:
        if not world.deaths():
            detail = traceback.format_exc()
            text = f"{type(error).__name__}: {error}"
            checks.append(Check(Verdict.ERROR, test.requirements, "the tester does not stumble", text))
    try:
        world.settle()
    except ConformanceError as error:
        checks.append(Check(Verdict.ERROR, test.requirements, "the processes of the network end", str(error)))
    checks += scene.checks
    checks += deaths(world, test.requirements)
    if not skipped and test.rules:
        checks += rules(world, world.sent(), strangers=scene.strangers, restarts=scene.restarts)
    if skipped and all(check.verdict is Verdict.PASS for check in checks):
        verdict, reason = Verdict.NOT_APPLICABLE, skipped
    else:
        verdict = worst(check.verdict for check in checks) or Verdict.INCONCLUSIVE
        reason = _reason(checks, verdict)
    return msgspec.structs.replace(
        _result(cell, test, profile, verdict, reason),
        duration_s=round(world.now / 1e9, 3),
        checks=tuple(checks),
        spreads=tuple(scene.spreads),
        moments=tuple(scene.moments),
        left_out=scene.left_out,
        stations=tuple(_stations(test, world)),
        links=world.link_counters(),
        error_detail=detail,
    )


def _reason(checks: list[Check], verdict: Verdict) -> str:
    if verdict is Verdict.PASS:
        return ""
    decisive = next((check for check in checks if check.verdict is verdict), None)
    if decisive is None:
        return "the test checked nothing"
    return f"{decisive.expected}: {decisive.observed}" if decisive.observed else decisive.expected


def _stations(test: NetworkTest, world: World) -> Iterator[StationResult]:
    sent = Counter(each.place for each in world.sent())
    for place in world.places:
        yield StationResult(
            place=place.number,
            implementation=place.implementation,
            profile=place.codec.profile.name,
            node_id=node_text(place.node_id),
            neighbours=test.shape.neighbours(place.number),
            beacons=sent[place.number],
            death=world.deaths().get(place.number, ""),
        )


def _result(cell: Cell, test: NetworkTest, profile: str, verdict: Verdict, reason: str) -> CellResult:
    words = ["dcp-conformance", "interop", "--only", cell.name, "--seed", str(cell.seed)]
    return CellResult(
        a=cell.a,
        b=cell.b,
        test=test.id,
        purpose=test.purpose,
        requirements=test.requirements,
        network=test.shape.name,
        profile=profile,
        world=cell.world,
        seed=cell.seed,
        verdict=verdict,
        reason=reason,
        rerun=" ".join([*words, "--virtual"] if cell.world == "virtual" else words),
    )
