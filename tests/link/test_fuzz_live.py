"""The fuzzer against processes that really die, hang and fall silent."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.target import TargetOptions, open_target
from dcp_lab.fuzz import Frame
from dcp_lab.fuzz.execute.live import LiveTarget

from ..ports import own_port
from ..waiting import PATIENCE, eventually
from .conftest import Namespace
from .faulty_node import WORD

LINK = f"udp:239.73.126.79:{own_port()}"
HARMLESS = Frame(b"\x01\x49\x7e")
BAD = Frame(b"\x01\x49\x7e" + WORD)


def faulty(folder: Path, fault: str, link: str = LINK, identifier: str = "02:00:00:00:00:01") -> str:
    script = Path(__file__).with_name("faulty_node.py")
    return shlex.join([sys.executable, str(script), fault, str(folder / "n.sock"), link, identifier])


def patient(folder: Path) -> Path:
    """A PICS by which an implementation may be kept waiting by the machine: four markers take four seconds."""
    path = folder / "patient.toml"
    path.write_text("[pixit]\nleast_patience_ms = 1000\n")
    return path


@contextlib.contextmanager
def live(folder: Path, start: str, *, upper: bool | None = None) -> Iterator[LiveTarget]:
    """A process over UDP. ``upper``: the process is started externally, with an upper tester or without."""
    pics = patient(folder)
    options = TargetOptions(link=LINK, start=start, beacon_period_ms=20, pics=pics)
    with contextlib.ExitStack() as stack:
        if upper is not None:
            started = subprocess.Popen(shlex.split(start), start_new_session=True, stderr=subprocess.DEVNULL)
            stack.callback(started.wait, PATIENCE)
            stack.callback(os.killpg, started.pid, signal.SIGKILL)
            path = folder / "n.sock"
            eventually(path.exists, "the node listens")
            options = TargetOptions(link=LINK, ut=f"unix:{path}" if upper else None, beacon_period_ms=20, pics=pics)
        opened = stack.enter_context(open_target(options))
        opened.runner.prepare()
        yield LiveTarget(opened, rate=5000)


@pytest.mark.parametrize("position", [0, 1000])
def test_a_crash_is_noticed_at_its_frame_and_costs_one_restart(tmp_path, position):
    steps = [*[HARMLESS] * position, BAD, *[HARMLESS] * 100_000]
    with live(tmp_path, faulty(tmp_path, "dies")) as target:
        effect = target.run(steps)
        assert effect is not None
        assert effect.kind == "dead"
        assert "a frame that it cannot stand" in effect.detail
        # A process needs a moment to die, and may have to wait for it; it must not take the rest of the frames.
        assert position <= effect.step < len(steps) - 1
        assert target.run([HARMLESS]) is None
        assert target.restarts == 1


@pytest.mark.parametrize("fault", ["hangs", "mute"])
def test_a_hanging_process_is_detected_and_restarted(tmp_path, fault):
    with live(tmp_path, faulty(tmp_path, fault)) as target:
        effect = target.run([HARMLESS, BAD])
        assert effect is not None
        assert effect.signature == "mute: mute"
        assert target.run([HARMLESS]) is None
        assert target.restarts == 1


def test_a_process_with_a_new_identifier_after_each_start_is_recognised(tmp_path):
    with live(tmp_path, faulty(tmp_path, "dies", identifier="")) as target:
        assert target.run([BAD]) is not None
        before = target.session.sut_id
        assert target.run([HARMLESS]) is None
        assert target.session.sut_id != before


@pytest.mark.parametrize("upper", [True, False])
def test_an_externally_restarted_process_is_recognised_by_its_beacons(tmp_path, upper):
    again = shlex.join(["sh", "-c", f"while true; do {faulty(tmp_path, 'dies')}; done"])
    with live(tmp_path, again, upper=upper) as target:
        # Each look brings a beacon, so that numbers have something to begin again from.
        for _ in range(4):
            assert target.run([HARMLESS]) is None
        effect = target.run([BAD])
        assert effect is not None
        # On a busy machine it may not be back before four markers have gone unanswered.
        assert effect.signature in (("mute: upper",) if upper else ("dead: restarted", "mute: mute"))
        assert target.run([HARMLESS]) is None
        assert target.restarts == 0


def test_an_interrupted_campaign_keeps_its_findings_and_can_be_resumed(namespace: Namespace, tmp_path):
    words = ["--interface", "near", "--start", faulty(tmp_path, "dies", "eth:far"), "--beacon-period", "20"]
    words += ["--pics", str(patient(tmp_path))]
    folder = tmp_path / "findings"
    python = [sys.executable, "-c", "from dcp_conformance.cli import main; main()"]
    around = ["ip", "netns", "exec", namespace.name, *python]
    fuzz = [*around, "fuzz", "live", *words, "--artefacts", str(folder), "--rate", "5000"]
    campaign = subprocess.Popen([*fuzz, "--max-time", "600"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert campaign.stderr is not None
    for line in campaign.stderr:
        if "minimising it" in line:
            campaign.send_signal(signal.SIGTERM)
            break
    out, err = campaign.communicate(timeout=PATIENCE)
    assert campaign.returncode == 1, out + err
    assert "stopped" in err
    [artefact] = folder.glob("dead-*.json")
    cases = json.loads((folder / "campaign.json").read_text())["cases"]
    fuzz[fuzz.index("--start") + 1] = faulty(tmp_path, "none", "eth:far")
    done = subprocess.run([*fuzz, "--resume", "--max-cases", "1"], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 1, done.stdout + done.stderr
    assert json.loads((folder / "campaign.json").read_text())["cases"] == cases + 1
    replay = [*around, "fuzz", "replay", str(artefact), *words, "--attempts", "1"]
    done = subprocess.run(replay, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout[:6]) == (1, "failed"), done.stdout + done.stderr


def test_a_second_process_is_not_started_beside_a_running_one(tmp_path):
    """Both would speak under one name, and be blamed for each other."""
    start = faulty(tmp_path, "none")
    other = subprocess.Popen(shlex.split(start), start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        eventually((tmp_path / "n.sock").exists, "the node listens")
        (tmp_path / "second").mkdir()
        second = faulty(tmp_path / "second", "none")
        with (
            pytest.raises(
                UsageError, match=r"--start: 02:00:00:00:00:01 has answered on .* before it was started: end"
            ),
            open_target(TargetOptions(link=LINK, start=second, beacon_period_ms=20)),
        ):
            pytest.fail("it was started")
        # A command that launches something says by itself what it thinks of that.
        with open_target(TargetOptions(link=LINK, start="true", beacon_period_ms=20)) as opened:
            verdict = opened.runner.run(all_cases()[SANITY]).verdict
        assert verdict is Verdict.PASS
    finally:
        os.killpg(other.pid, signal.SIGKILL)
        other.wait(PATIENCE)


def test_a_process_that_starts_slowly_is_waited_for(tmp_path):
    start = shlex.join(["sh", "-c", f"sleep 3; exec {faulty(tmp_path, 'none')}"])
    python = [sys.executable, "-c", "from dcp_conformance.cli import main; main()"]
    words = ["run", "--link", LINK, "--beacon-period", "20", "--start", start, SANITY]
    done = subprocess.run([*python, *words], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(("fault", "passes"), [("", True), ("M-DATA-01-swapped-length", False)])
def test_the_page_of_the_model_has_a_test_for_pytest(tmp_path: Path, fault: str, passes: bool) -> None:
    """The program of docs/model.md, with the node of this kit, or a mutant of it, in the place of ``build/my-node``."""
    page = (Path(__file__).parents[2] / "docs" / "model.md").read_text()
    program = page.partition("in `test_node.py`:\n\n```python\n")[2].partition("```")[0]
    link, socket = LINK.removeprefix("udp:"), tmp_path / "node.sock"
    node = (
        [sys.executable, "-m", "dcp_selftest.mutants", fault]
        if fault
        else [str(Path(sys.executable).parent / "dcp-node"), "run"]
    )
    start = shlex.join([*node, "--link", LINK, "--control", str(socket), "--beacon-period", "20"])
    program = program.replace("build/my-node --udp 239.1.1.1:5950 --control /tmp/my-node.sock", start)
    program = program.replace("239.1.1.1:5950", link).replace("/tmp/my-node.sock", str(socket))
    (tmp_path / "test_node.py").write_text(program.replace("sequences=20", "sequences=5"))
    (tmp_path / "my-node.toml").write_text("[pixit]\nbeacon_period_ms = 20\n")
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "test_node.py"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=10 * PATIENCE, check=False)
    assert (done.returncode == 0) is passes, done.stdout + done.stderr
    assert ("a valid beacon" in done.stdout) is not passes
