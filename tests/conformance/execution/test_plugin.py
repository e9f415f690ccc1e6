"""The cases as items of pytest: by several workers, in any order; and runs that no setting of pytest disturbs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.outcome import AS_EXPECTED, TESTER_ERROR, UNEXPECTED, USAGE
from dcp_conformance.reporting import load_results

from ...waiting import PATIENCE

pytestmark = pytest.mark.part("tools")

CHOSEN = ("-k", "TC_SRP_REC or TC_BP_CLAIM")
#: Fails where a PICS claims what our node does not do.
FAILS = "TC_BP_CLAIM_TI_01"
COMMAND = (sys.executable, "-c", "from dcp_conformance.cli import main; main()")
RUN = (*COMMAND, "run", "--in-process", "SRP-*", "VD-UPD-0*")


def started(folder: Path, command: tuple[str, ...], **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )


class Pytest:
    """Calls pytest with the plugin in a folder, which is the root for pytest; ``shown`` is all that it has printed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shown = ""

    def __call__(self, *options: str, target: tuple[str, ...] = ("--dcp-in-process",)) -> int:
        plugin = ("-p", "dcp_conformance.pytest_plugin", "--pyargs", "dcp_conformance.suite")
        done = started(
            self.folder,
            (sys.executable, "-m", "pytest", *plugin, *target, "--rootdir", ".", "--junitxml", "out.xml", *options),
            PYTHONPATH=str(self.folder),
        )
        self.shown = done.stdout + done.stderr
        assert "Traceback" not in self.shown
        return done.returncode

    def verdicts(self) -> list[tuple[str, str]]:
        """Cases in the order in which their reports came, with their verdicts."""
        found = []
        for case in ET.parse(self.folder / "out.xml").getroot().iter("testcase"):
            values = {each.get("name"): each.get("value") for each in case.iter("property")}
            found.append((str(case.get("name")), str(values.get("verdict"))))
        return found


@pytest.fixture
def run_pytest(tmp_path: Path) -> Pytest:
    return Pytest(tmp_path)


@pytest.fixture
def claims(tmp_path: Path) -> tuple[str, ...]:
    """A node that fails ``FAILS``."""
    path = tmp_path / "claims.toml"
    path.write_text("[pics]\ntriggered_beacons = true\n")
    return ("--dcp-in-process", "--dcp-pics", str(path))


class TestWorkers:
    def test_several_workers_give_the_same_verdicts_as_one_process(self, run_pytest: Pytest, claims: tuple[str, ...]):
        assert run_pytest(*CHOSEN, target=claims) == UNEXPECTED
        alone = run_pytest.verdicts()
        # It ends with the sanity case; no worker knows which case is the last one.
        assert [name for name, _ in alone].count(SANITY) == 2
        assert run_pytest(*CHOSEN, "-n", "2", target=claims) == UNEXPECTED
        together = run_pytest.verdicts()
        assert sorted(together) == sorted(set(alone))
        assert len(together) > 10
        assert (FAILS, "fail") in together
        assert "1 failed" in run_pytest.shown

    def test_all_workers_know_the_expected_results(self, run_pytest: Pytest, claims: tuple[str, ...], tmp_path: Path):
        known = tmp_path / "expected.toml"
        known.write_text(f'[[expected]]\ncase = "{FAILS}"\nverdict = "fail"\nreason = "known"\n')
        options = (*CHOSEN, "-n", "2", "--dcp-expected", str(known))
        assert run_pytest(*options, target=claims) == AS_EXPECTED, run_pytest.shown
        known.write_text('[[expected]]\ncase = "TC_SRP_REC_BV_02"\nverdict = "fail"\nreason = "known"\n')
        assert run_pytest(*options) == UNEXPECTED
        assert "unexpected pass" in run_pytest.shown

    def test_the_run_can_stop_at_the_first_failure(self, run_pytest: Pytest, claims: tuple[str, ...]):
        assert run_pytest("-n", "2", "-x", "-k", "TC_BP", target=claims) == UNEXPECTED
        assert "stopping after 1 failures" in run_pytest.shown

    def test_a_killed_worker_is_an_error_of_the_tester(self, run_pytest: Pytest, tmp_path: Path):
        (tmp_path / "killing.py").write_text(
            "import os\n"
            "def pytest_runtest_call(item):\n"
            f"    if item.name == {FAILS!r} and hasattr(item.config, 'workerinput'): os._exit(9)\n"
        )
        options = (*CHOSEN, "-n", "2", "--max-worker-restart", "0", "-p", "killing")
        assert run_pytest(*options) == TESTER_ERROR, run_pytest.shown
        assert "crashed" in run_pytest.shown

    @pytest.mark.parametrize(
        ("target", "options", "message"),
        [
            (("--dcp-link", "udp"), ("-n", "2"), "-n: the implementation exists only once"),
            (
                ("--dcp-in-process",),
                ("-n", "2", "--dist", "each"),
                "--dist each: every case would have several results",
            ),
            (("--dcp-profile", "dcp-9"), ("-n", "2"), "unknown profile 'dcp-9'"),
        ],
    )
    def test_contradictory_options_are_refused(
        self, run_pytest: Pytest, target: tuple[str, ...], options: tuple[str, ...], message: str
    ):
        assert run_pytest(*options, target=target) == pytest.ExitCode.USAGE_ERROR
        assert f"ERROR: {message}" in run_pytest.shown

    def test_the_command_has_no_workers_of_pytest(self, tmp_path: Path):
        done = started(tmp_path, (*RUN, "--pytest", "-n 2"))
        assert done.returncode == USAGE
        assert "-n: dcp-conformance run has processes of its own (--jobs)" in done.stderr


class TestOrder:
    def test_last_failed_cases(self, run_pytest: Pytest, claims: tuple[str, ...]):
        assert run_pytest(*CHOSEN, target=claims) == UNEXPECTED
        # Workers read what one process has written, and one process what workers have.
        for workers in (("-n", "2"), ()):
            assert run_pytest(*CHOSEN, *workers, "--lf", target=claims) == UNEXPECTED
            # Sanity cases are run whatever is chosen.
            assert {name for name, _ in run_pytest.verdicts()} == {SANITY, FAILS}

    def test_another_plugin_may_change_it(self, run_pytest: Pytest, tmp_path: Path):
        (tmp_path / "reversing.py").write_text("def pytest_collection_modifyitems(items): items.reverse()\n")
        assert run_pytest(*CHOSEN) == AS_EXPECTED
        usual = run_pytest.verdicts()
        assert usual[0][0] == usual[-1][0] == SANITY
        assert run_pytest(*CHOSEN, "-p", "reversing") == AS_EXPECTED
        assert run_pytest.verdicts() == [usual[0], *reversed(usual[1:-1]), usual[-1]]
        assert run_pytest(*CHOSEN, "-n", "2", "-p", "reversing") == AS_EXPECTED
        assert sorted(run_pytest.verdicts()) == sorted(set(usual))


def verdicts_of(folder: Path, *options: str, **environment: str) -> list[tuple[str, str]]:
    """The cases of a run with their verdicts, in order."""
    done = started(folder, (*RUN, "--report-dir", str(folder / "report"), *options), **environment)
    assert done.returncode == AS_EXPECTED, done.stdout + done.stderr
    cases = [(case.id, str(case.verdict)) for case in load_results(folder / "report").cases]
    assert len(cases) > 30
    return cases


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, str]]:
    """Verdicts of an undisturbed run."""
    return verdicts_of(tmp_path_factory.mktemp("usual"))


class TestStrayEnvironment:
    """Nothing that a user has set for pytest or Python changes what comes of a run."""

    @pytest.mark.parametrize("options", [(), ("--pytest", "-q")], ids=["alone", "with pytest"])
    def test_files_and_variables(self, tmp_path: Path, usual: list[tuple[str, str]], options: tuple[str, ...]):
        (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = --collect-only\npython_files = *\n")
        (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\naddopts = '--collect-only'\n")
        (tmp_path / "conftest.py").write_text("raise SystemExit('a conftest.py of the user')\n")
        # Each of these options alone would change the verdicts, their order or the exit status. The run also does
        # without the folder that the user is in, in which anything may have the name of a module.
        found = verdicts_of(
            tmp_path, *options, PYTEST_ADDOPTS="-k nothing -n 2 --collect-only --no-such-option",
            PYTEST_PLUGINS="no_such_plugin", PYTEST_DISABLE_PLUGIN_AUTOLOAD="1", CI="1",
            HYPOTHESIS_PROFILE="x", PYTHONOPTIMIZE="1", PYTHONHASHSEED="77", PYTHONWARNINGS="error",
            PYTHONIOENCODING="ascii", PYTHONDEVMODE="1", LC_ALL="C", COLUMNS="20", FORCE_COLOR="1",
        )  # fmt: skip
        assert found == usual

    def test_python_without_docstrings_is_refused(self, tmp_path: Path):
        """Docstrings contain the sections and purposes of cases."""
        done = started(tmp_path, RUN, PYTHONOPTIMIZE="2")
        assert done.returncode == USAGE
        assert re.fullmatch(r"dcp-conformance: .* without docstrings \(-OO, PYTHONOPTIMIZE=2\).*\n", done.stderr)
