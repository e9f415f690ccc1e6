"""Campaigns by several processes: reproducible, each finding once, no lost findings and no remaining processes."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import select
import signal
import subprocess
import sys
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
from dcp_conformance.errors import WorkerError
from dcp_lab.fuzz import Campaign, Effect, Frame, Limits
from dcp_lab.fuzz.campaign import State, read_state
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.coverage import counter_of
from dcp_selftest.cli.fuzz import codec_campaign, stack_campaign
from dcp_selftest.fuzz.worker import SLOT_SIZE, Order, Settings, Slot, Worker
from dcp_selftest.fuzz.workers import run_in_workers

from dcp_codec import Codec
from dcp_codec.common.signals import Stop

from ...waiting import PATIENCE

pytestmark = pytest.mark.part("tools")

#: Shows three different findings in a few hundred tests.
SEVERAL = "M-VD-IC-02-types-exchanged"
#: Shows the same with every test.
ALWAYS = "M-DATA-01-swapped-length"


def options_of(mutant: str = "", *, directory: Path | None = None, resume: bool = False, seed: int = 1) -> dict:
    options = {"profile": "dcp-2.0", "seed": seed, "mutant": mutant, "recording": ()}
    return options | {"artefacts": directory, "resume": resume}


@pytest.fixture
def run():
    """Runs a campaign by workers; ``hooks`` are the callbacks of the campaign."""

    def run(limits: Limits, jobs: int = 2, make=None, *, guided: bool = False, hooks=None, **options) -> Campaign:
        said = options_of(**options)
        with stack_campaign(said) as campaign:
            campaign.directory = said["artefacts"]
            if said["resume"]:
                campaign.resume()
            for name, hook in (hooks or {}).items():
                setattr(campaign, name, hook)
            made = make(said) if make is not None else partial(stack_campaign, said)
            kept.append(campaign)
            run_in_workers(campaign, made, jobs, limits, guided=guided)
        return campaign

    kept: list[Campaign] = []
    run.kept = kept
    yield run
    assert multiprocessing.active_children() == []


@pytest.fixture
def faulty(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    return importlib.import_module("faulty_workers")


def told(campaign: Campaign) -> dict:
    """Everything that has come of a campaign but the time that it took."""
    state = json.loads(json.dumps({name: getattr(campaign.state, name) for name in ("cases", "frames", "again")}))
    state |= {"findings": campaign.state.findings, "kinds": campaign.state.kinds, "coverage": campaign.state.coverage}
    return state


# -- the same every time ---------------------------------------------------------------------------------------


def test_findings_depend_on_the_seed_only(run):
    def stop(effect: Effect) -> None:
        # One worker stands still for a second, time and again: the other gets ahead of it.
        os.kill(min(child.pid for child in multiprocessing.active_children()), signal.SIGSTOP)

    def continue_campaign(progress: object) -> None:
        os.kill(min(child.pid for child in multiprocessing.active_children()), signal.SIGCONT)

    one = run(Limits(cases=200), mutant=SEVERAL)
    other = run(Limits(cases=200), mutant=SEVERAL, hooks={"on_effect": stop, "on_progress": continue_campaign})
    assert len(one.state.findings) > 2
    same = told(one) == told(other)
    assert same
    assert list(one.state.findings) == list(other.state.findings)
    assert [each.id for each in one.artefacts] == [each.id for each in other.artefacts]


def test_workers_follow_their_seeds_and_results_are_merged(run):
    campaign = run(Limits(cases=101))
    kinds, fields, frames = Counter(), Counter(), 0
    for number, cases in enumerate((51, 50)):
        with stack_campaign(options_of(), f"1/0/{number}") as alone:
            state = alone.run(Limits(cases=cases))
        kinds += Counter(state.kinds)
        fields += counter_of(state.coverage.fields)
        frames += state.frames
        possible = state.coverage.possible
    state = campaign.state
    assert (state.cases, state.frames, Counter(state.kinds)) == (101, frames, kinds)
    assert counter_of(state.coverage.fields) == fields
    assert state.coverage.possible == possible == len(fields) + len(state.coverage.missing)


def test_guided_workers_are_reproducible(run):
    one, other = (run(Limits(cases=16), guided=True) for _ in range(2))
    assert one.state.coverage.lines > 1000
    same = told(one) == told(other)
    assert same


def test_functions_are_fuzzed_by_workers(run):
    with codec_campaign(("beacon", "pics"), options_of()) as campaign:
        make = partial(codec_campaign, ("beacon", "pics"), options_of())
        state = run_in_workers(campaign, make, 2, Limits(cases=200))
    assert state.cases == sum(state.kinds.values()) == 200
    assert set(state.kinds) == {"beacon", "pics"}


# -- findings --------------------------------------------------------------------------------------------------


def test_each_finding_is_minimised_and_kept_once(run, tmp_path):
    effects: list[Effect] = []
    campaign = run(Limits(cases=90), 3, mutant=ALWAYS, directory=tmp_path, hooks={"on_effect": effects.append})
    assert len(effects) == len(campaign.artefacts) == 1
    assert campaign.state.again == 89
    [artefact] = campaign.artefacts
    assert artefact.minimised
    assert artefact.confirmed
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [f"{artefact.id}.json", f"{artefact.id}.mcap", "campaign.json"]
    )


def test_a_campaign_is_resumed_with_any_number_of_workers(run, tmp_path):
    with stack_campaign(options_of(ALWAYS)) as alone:
        alone.directory = tmp_path
        alone.run(Limits(cases=20))
    files = sorted(tmp_path.iterdir())
    run(Limits(cases=21), 3, mutant=ALWAYS, directory=tmp_path, resume=True)
    run(Limits(cases=22), 2, mutant=ALWAYS, directory=tmp_path, resume=True)
    state = read_state(tmp_path)
    assert (state.cases, state.again, len(state.findings)) == (63, 62, 1)
    # Known findings are not minimised again.
    assert sorted(tmp_path.iterdir()) == files
    with stack_campaign(options_of(ALWAYS, directory=tmp_path, resume=True)) as alone:
        alone.directory = tmp_path
        alone.resume()
        alone.run(Limits(cases=10))
    assert read_state(tmp_path).cases == 73


# -- limits ----------------------------------------------------------------------------------------------------


def test_the_limit_of_findings_ends_a_campaign(run):
    campaign = run(Limits(findings=2), mutant=SEVERAL)
    assert len(campaign.artefacts) == len(campaign.state.findings) == 2


def test_the_time_limit_ends_a_campaign_with_its_findings(run):
    campaign = run(Limits(seconds=0.3), mutant=ALWAYS)
    assert len(campaign.artefacts) == 1
    assert campaign.state.cases == campaign.state.again + 1


def test_rate_and_progress_are_those_of_all_workers_together(run):
    progress = []
    campaign = run(Limits(cases=12, rate=8), hooks={"on_progress": progress.append})
    # Six each, with a quarter of a second for each.
    assert campaign.state.seconds >= 1.5
    assert 1 <= len(progress) <= campaign.state.seconds
    assert 2 <= progress[-1].cases <= 12


# -- being ended -----------------------------------------------------------------------------------------------


def test_a_signal_ends_all_workers_and_findings_are_kept(run, tmp_path):
    def stop(effect: Effect) -> None:
        # No worker has minimised it yet.
        signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        run(Limits(seconds=60), mutant=ALWAYS, directory=tmp_path, hooks={"on_effect": stop})
    assert signal.getsignal(signal.SIGINT) == before
    [campaign] = run.kept
    assert len(campaign.artefacts) == 1
    state = read_state(tmp_path)
    assert list(state.findings.values()) == [campaign.artefacts[0].id]
    assert state.cases == state.again + 1


def test_a_killed_worker_is_reported_and_ends_the_campaign(run, tmp_path):
    def kill(effect: Effect) -> None:
        os.kill(max(child.pid for child in multiprocessing.active_children()), signal.SIGKILL)

    with pytest.raises(WorkerError, match=r"worker 2 of 2 \(seed '1/0/1'\) was ended by SIGKILL after \d+ tests"):
        run(Limits(seconds=60), mutant=ALWAYS, directory=tmp_path, hooks={"on_effect": kill})
    assert len(read_state(tmp_path).findings) == 1


def test_a_crash_of_a_worker_is_a_finding_with_its_current_steps(run, faulty, tmp_path):
    done = tmp_path / "done"
    with pytest.raises(WorkerError, match=r"worker 2 of 2 .* was ended by SIGSEGV after 11 tests"):
        run(Limits(cases=100), make=lambda said: partial(faulty.crashing, said, 11, done), directory=tmp_path)
    [campaign] = run.kept
    [artefact] = campaign.artefacts
    assert (artefact.effect.kind, artefact.effect.detail) == ("dead", "its process was ended by SIGSEGV")
    assert not artefact.minimised
    with stack_campaign(options_of(), "1/0/1") as alone:
        alone.run(Limits(cases=11))
        assert artefact.as_steps() == alone.generator.draw()
    # And the tests of the others count.
    assert read_state(tmp_path).cases > 11


def test_a_failed_worker_reports_the_reason_and_its_findings_are_kept(run, faulty):
    with pytest.raises(WorkerError, match=r"worker 1 of 2 .* after 5 tests: MemoryError: nothing left \(in draw, "):
        run(Limits(cases=100), make=lambda said: partial(faulty.failing, said, 5), mutant=ALWAYS)
    [campaign] = run.kept
    assert len(campaign.artefacts) == 1


def test_workers_that_cannot_start_report_the_reason(run, faulty):
    with pytest.raises(WorkerError, match="nothing is there for 1/0/"):
        run(Limits(cases=100), make=lambda said: faulty.unusable)


def children_of(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(path.parent.name))
    return found


@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGTERM, 1)])
def test_no_process_remains_however_a_campaign_ends(number, status):
    command = [sys.executable, "-c", "from dcp_selftest.cli import main; main()", "fuzz", "stack", "--jobs", "2"]
    with subprocess.Popen([*command, "--mutant", ALWAYS], stdout=subprocess.PIPE, text=True) as process:
        # Workers are at work.
        assert process.stdout is not None
        assert process.stdout.readline().startswith("bad-beacon-")
        children = [os.pidfd_open(pid) for pid in children_of(process.pid)]
        assert len(children) >= 2
        process.send_signal(number)
        for child in children:
            readable, _, _ = select.select([child], [], [], PATIENCE)
            assert readable, "a process is left"
            os.close(child)
        assert process.wait(PATIENCE) == status


# -- one worker ------------------------------------------------------------------------------------------------


class Showing:
    """Shows an effect of a bad step that is not the first; a stop comes with the test after so many."""

    name = "showing"

    def __init__(self, stop: Stop, after: int) -> None:
        self.stop = stop
        self.left = after

    def run(self, steps):
        self.left -= 1
        if not self.left:
            self.stop(signal.SIGTERM, None)
        for at, step in enumerate(steps):
            if at and step.octets == b"bad":
                return Effect("mute", "nothing comes", at)
        return None


class Drawn:
    kinds = ("drawn",)

    def draw(self):
        return [Frame(b"good"), Frame(b"good"), Frame(b"bad"), Frame(b"good")]


def test_a_worker_stopped_while_minimising_reports_its_finding():
    codec, stop, slot = Codec("dcp-2.0"), Stop(), Slot(bytearray(SLOT_SIZE))
    campaign = Campaign(codec, Showing(stop, 7), Drawn(), SavedTarget("stack"), 1)
    settings = Settings("1/0/0", State("dcp-2.0", "stack", 1), guided=False, rate=None, parent=0)
    worker = Worker(campaign, settings, slot, stop)
    worker.carry_out(Order((), 2, None))
    [shown] = worker.report().shown
    assert shown.effect.signature == "mute: nothing comes"
    worker.carry_out(Order((shown.effect.signature,), 10, None))
    report = worker.report()
    assert report.totals.cases == slot.cases == 2
    assert report.totals.effects == {"mute: nothing comes": 2}
    [finding] = report.findings
    assert finding.minimised
    # Smaller than it was, but not as small as it can be.
    assert [step.octets for step in finding.steps] == [b"good", b"bad"]


def test_an_earlier_stop_signal_is_obeyed_once():
    stop = Stop()
    stop(signal.SIGTERM, None)
    with pytest.raises(KeyboardInterrupt), stop.interruptible_by_signals():
        pytest.fail("no interrupt")
    with pytest.raises(KeyboardInterrupt), Stop().interruptible_by_signals() as _:
        raise KeyboardInterrupt
    stop(signal.SIGTERM, None)


def test_a_slot_holds_the_current_steps_of_a_worker_unless_too_long():
    memory = bytearray(SLOT_SIZE)
    slot = Slot(memory)
    assert (slot.cases, slot.steps()) == (0, [])
    steps = [Frame(b"a", b"b", "c")]
    slot.write(7, steps)
    assert (slot.cases, slot.steps()) == (7, steps)
    slot.write(8, [Frame(bytes(SLOT_SIZE))])
    assert (slot.cases, slot.steps()) == (8, [])


# -- the command -----------------------------------------------------------------------------------------------


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from dcp_selftest.cli import main; main()", "fuzz", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)


def test_a_campaign_by_workers_is_reported_like_any_other(tmp_path):
    options = ("--mutant", ALWAYS, "--artefacts", str(tmp_path), "--max-cases", "40")
    done = fuzz("stack", "--jobs", "2", *options, "--coverage")
    assert done.returncode == 1
    assert "field x what was done to it" in done.stdout
    assert "known findings occurred again 39 times" in done.stdout
    assert "minimising it" in done.stderr
    assert fuzz("replay", str(tmp_path)).stdout.startswith("failed ")
    again = fuzz("stack", "--jobs", "auto", "--resume", *options, "-q")
    # Earlier findings of the campaign are reported again, and there are no new ones.
    *known, last = again.stdout.splitlines()
    assert (again.returncode, last[:9]) == (1, "80 cases,")
    assert known == done.stdout.splitlines()[-1 - len(known) : -1]


def test_one_job_starts_no_process():
    code = (
        "import atexit, sys; from dcp_selftest.cli import main;"
        "atexit.register(lambda: print('multiprocessing.process' in sys.modules));"
        "main(['fuzz', 'stack', '--max-cases', '3', '--jobs', '1', '-q'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "False"
