"""Node processes on a real virtual Ethernet: they send beacons, agree, and clean up.

Everything that takes its time runs concurrently, in separate testbeds, and beside the other tests here: that they do
not disturb one another is part of what is tested.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from dcp_lab.sim.scenario.definition import LinkQuality, ScenarioError
from dcp_lab.sim.scenario.report import LATE, SLOW_START
from dcp_lab.sim.testbed import namespaces
from dcp_lab.sim.testbed.fabric import chance, netem_options

from dcp_codec import Codec
from dcp_codec.capture import open_capture
from dcp_codec.network.namespaces import enter_command
from dcp_codec.network.sockets import ETHERNET_HEADER

from ..waiting import PATIENCE, eventually

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")
pytestmark = pytest.mark.tool("ip")

ROOT = Path(__file__).parents[2]
LINE = ROOT / "examples" / "line.toml"


@pytest.fixture(scope="module", autouse=True)
def rights() -> None:
    if shutil.which("ip") is None:
        return
    if not namespaces.permitted():
        message = "network namespaces cannot be made here: run as root (CAP_NET_ADMIN)"
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "dcp_stack.cli", "testbed", *map(str, arguments)]


def start(*arguments: object, prefix: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*prefix, *command(*arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    )


def namespaces_of(process: subprocess.Popen[str]) -> list[str]:
    return namespaces.existing(f"{namespaces.PREFIX}-{process.pid}")


def written(directory: Path, name: str, text: str) -> Path:
    path = directory / name
    path.write_text(text)
    return path


#: A neighbour that a busy machine keeps waiting is not forgotten.
RATES = """
nodes = {nodes}
duration_s = 20
[srp]
neighbour_table_timeout_ms = 60000
[[tracks]]
source = "track:walk,rate=20"
[[events]]
do = "create"
at_s = 0.2
node = 0
variable = 1
text = "x"
[[expect]]
that = "converged"
within_s = 20
"""
ALL_KNOW = '[[expect]]\nthat = "neighbours"\nnode = {node}\nare = {others}\n'


class Runs:
    """Testbeds that run at the same time."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._outputs: dict[str, tuple[str, str]] = {}
        for nodes in (2, 3, 4):
            text = RATES.format(nodes=nodes)
            for node in range(nodes):
                text += ALL_KNOW.format(node=node, others=[each for each in range(nodes) if each != node])
            self._start(f"rates-{nodes}", "--scenario", written(directory, f"rates-{nodes}.toml", text))
        self._start("line", "--scenario", LINE)
        # The third node is out of reach: half of the frames are lost on their way to each.
        self._start("lossy", 3, "--loss", 0.5, "--duration", 10)

    def _start(self, name: str, *arguments: object) -> None:
        self.processes[name] = start(*arguments, "--json", "--keep", self.directory / name)

    def report(self, name: str) -> dict:
        """Report of a testbed; its exit status has to agree."""
        process = self.processes[name]
        if name not in self._outputs:
            self._outputs[name] = process.communicate(timeout=PATIENCE)
        output, errors = self._outputs[name]
        assert output, errors
        report = json.loads(output)
        assert process.returncode == (0 if report["met"] else 1)
        return report

    def errors(self, name: str) -> str:
        """Return what a testbed with a report wrote to standard error."""
        return self._outputs[name][1]

    def end(self) -> None:
        """End the processes that have not been waited for."""
        for name, process in self.processes.items():
            if name not in self._outputs:
                process.terminate()
                process.communicate(timeout=PATIENCE)


@pytest.fixture(scope="module")
def runs(rights, tmp_path_factory) -> Iterator[Runs]:
    made = Runs(tmp_path_factory.mktemp("testbeds"))
    try:
        yield made
    finally:
        made.end()


def unmet(report: dict) -> list[dict]:
    return [finding for finding in report["findings"] if not finding["met"]]


def too_busy(report: dict) -> bool:
    """Whether the machine was, for judging what is expected of times; as the testbed and its nodes say."""
    left_out = max(each["left_out_per_s"] for each in report["traffic"]) * report["duration_s"]
    return report["late_s"] > LATE or report["slowest_start_s"] > SLOW_START or left_out > 10 * LATE


def timeless(finding: dict) -> bool:
    """Whether a finding is about how it is at the end, or whether something can be at all."""
    return "at the end" in finding["what"] or finding["what"] in ("no node ends unexpectedly", "every event succeeds")


def test_a_testbed_says_how_long_it_takes_and_how_far_it_is(runs):
    runs.report("lossy")
    _, begin, progress = re.findall("dcp-node: (.*)", runs.errors("lossy"))[:3]
    assert begin == "starting 3 nodes; the scenario takes 10 s"
    assert re.fullmatch(r"\d+ s of 10 s", progress)


@pytest.fixture
def running() -> Iterator[subprocess.Popen[str]]:
    """A testbed of two nodes that run."""
    process = start(2, "--duration", 600)
    try:
        eventually(lambda: len(inside(process)) == 2, "the nodes start")
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=PATIENCE)


def inside(process: subprocess.Popen[str]) -> list[str]:
    """The processes in the namespaces of a testbed."""
    found = []
    for name in namespaces_of(process):
        found += subprocess.run(["ip", "netns", "pids", name], capture_output=True, text=True).stdout.split()
    return found


def runs_on(pid: str) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        stat = Path("/proc", pid, "stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.usefixtures("runs")
class TestEnds:
    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_a_signal_ends_the_testbed_orderly(self, running, number):
        nodes = inside(running)
        running.send_signal(number)
        _, errors = running.communicate(timeout=PATIENCE)
        assert running.returncode == 128 + number
        assert "the testbed is removed" in errors
        assert not namespaces_of(running)
        assert not any(runs_on(pid) for pid in nodes)

    def test_a_helper_process_cleans_up_after_a_killed_testbed(self, running):
        nodes = inside(running)
        running.kill()
        running.communicate(timeout=PATIENCE)
        eventually(lambda: not namespaces_of(running), "the namespaces go")
        assert not any(runs_on(pid) for pid in nodes)

    def test_the_next_start_removes_remaining_namespaces(self):
        ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
        left = f"{namespaces.PREFIX}-{ended.stdout.strip()}-1-n0"
        mine = f"{namespaces.own_prefix()}-n0"
        # The name contains the process id, because tests of another checkout may run at the same time.
        foreign = f"{namespaces.PREFIX}-not-one-of-ours-{os.getpid()}"
        namespaces.create([left, mine, foreign])
        sleeper = subprocess.Popen([*enter_command(left), "sleep", "100"])
        try:
            # A testbed that starts elsewhere sweeps, too, and may be first; and there may be more to sweep than this.
            swept = namespaces.sweep()
            eventually(lambda: left in swept or not Path("/run/netns", left).exists(), "it is removed")
            assert mine not in swept
            assert foreign not in swept
            assert sleeper.wait(PATIENCE) < 0
            assert namespaces.existing(namespaces.own_prefix()) == [mine]
            assert Path("/run/netns", foreign).exists()
        finally:
            sleeper.kill()
            namespaces.delete([mine])
            subprocess.run(["ip", "netns", "delete", foreign], check=True)
            assert not Path("/run/netns", left).exists()


@pytest.mark.usefixtures("runs")
class TestRefusals:
    def test_without_privileges_the_error_gives_a_remedy(self):
        if shutil.which("setpriv") is None:
            pytest.skip("setpriv is not on PATH")
        # Root without capabilities may not even make a user namespace for root.
        process = start(2, prefix=("setpriv", "--bounding-set", "-all", "--inh-caps", "-all"))
        output, errors = process.communicate(timeout=PATIENCE)
        if process.returncode == 0:
            pytest.skip("this kernel lets every user create namespaces")
        assert (process.returncode, output) == (2, "")
        assert errors.startswith("dcp-node: testbed: network namespaces cannot be created: run as root, or allow users")
        assert errors.count("\n") == 1

    @pytest.mark.parametrize(
        ("keys", "complaint"),
        [
            ("[bp]\nbeacon_period_ms = 0\n", "the nodes refuse this configuration: BPPAR_BEACON_PERIOD"),
            ("[bp]\nmax_packet_size = 5000\n", "BPPAR_MAXIMUM_PACKET_SIZE must be at most 1500"),
            (
                '[[tracks]]\nsource = "track:spiral"\n',
                "ended with status 2: dcp-node: track:spiral: no track 'spiral'",
            ),
        ],
    )
    def test_nodes_that_cannot_run_are_named_with_their_output(self, tmp_path, keys, complaint):
        scenario = written(tmp_path, "bad.toml", "nodes = 2\nduration_s = 3\n" + keys)
        process = start("--scenario", scenario)
        output, errors = process.communicate(timeout=PATIENCE)
        assert (process.returncode, output) == (2, "")
        # Before it, the command may have said how long the scenario takes.
        *before, last = errors.splitlines()
        assert complaint in last
        assert before in ([], ["dcp-node: starting 2 nodes; the scenario takes 3 s"])
        assert not namespaces_of(process)

    def test_qualities_as_options_of_netem(self):
        assert netem_options(LinkQuality(loss=0.125)) == "loss 12.5000%"
        everything = LinkQuality(loss=0.1, duplicate=0.01, delay_ms=5, jitter_ms=4)
        assert netem_options(everything) == "delay 7.000ms 2.000ms loss 10.0000% duplicate 1.0000%"
        assert netem_options(LinkQuality(reorder=0.25)) == "delay 50.000ms reorder 75.0000%"
        with pytest.raises(ScenarioError, match="reorder"):
            netem_options(LinkQuality(reorder=0.25, delay_ms=1))

    @pytest.mark.parametrize("quality", [LinkQuality(loss=0.2, burst=3), LinkQuality(corrupt_frames=0.1)])
    def test_impairments_that_the_kernel_lacks_need_the_relay(self, quality):
        with pytest.raises(ScenarioError, match="--links relay"):
            netem_options(quality)

    @pytest.mark.parametrize(("probability", "threshold"), [(0.5, 1 << 31), (1e-12, 0), (0.25, 1 << 30)])
    def test_chance_as_a_program(self, probability, threshold):
        assert f"53 0 1 {threshold}," in chance(probability)


class TestNodes:
    @pytest.mark.parametrize("nodes", [2, 3, 4])
    @pytest.mark.req("BP-TX-01")
    def test_nodes_send_beacons_at_ten_hertz_and_hear_one_another(self, runs, nodes):
        report = runs.report(f"rates-{nodes}")
        busy = too_busy(report)
        assert not [each for each in unmet(report) if timeless(each) or not busy], (busy, report)
        # A busy machine has them leave beacons out, which they count, and be late at the first and at the last look.
        tolerance = 0.02 + 2 * report["late_s"] / report["duration_s"]
        for each in report["traffic"]:
            assert each["beacons_per_s"] + each["left_out_per_s"] == pytest.approx(10, rel=tolerance)

    def test_a_line_agrees_after_all_kinds_of_events(self, runs):
        report = runs.report("line")
        busy = too_busy(report)
        assert not [each for each in unmet(report) if timeless(each) or not busy], (busy, report)
        what = [each["what"] for each in report["convergences"]]
        assert what == [
            "node 0 creates variable 7",
            "node 0 updates variable 7",
            "node 0 deletes variable 7",
            "node 0 creates variable 7",
            "node 4 is switched on",
            "partition 0,1",
            "node 0 updates variable 7",
            "the partition ends",
        ]
        # Updates on the other side of the partition arrive only after it ended.
        assert busy or report["convergences"][6]["took_s"] > 3

    def test_frames_are_lost_at_the_configured_rate(self, runs):
        report = runs.report("lossy")
        sent = sum(each["beacons_sent"] for each in report["traffic"])
        received = sum(each["beacons_received"] for each in report["traffic"])
        assert 0.35 < received / (2 * sent) < 0.65
        assert not [each for each in unmet(report) if timeless(each) or not too_busy(report)]

    def test_each_node_records_all_sent_and_received_frames(self, runs):
        report = runs.report("rates-3")
        codec = Codec("dcp-2.0")
        for each in report["traffic"]:
            numbers: dict[bytes, list[int]] = defaultdict(list)
            with open_capture(runs.directory / "rates-3" / f"node-{each['node']}.mcap") as capture:
                for frame in capture:
                    header = codec.decode(frame.data[ETHERNET_HEADER:]).bp
                    assert header is not None
                    numbers[header.sender_id].append(header.seqno)
            # Consecutive beacons, of itself from the first one.
            assert len(numbers) == 3
            assert numbers[bytes((2, 0, 0, 0, 0, each["node"]))][0] == 0
            assert all(found == list(range(found[0], found[-1] + 1)) for found in numbers.values())
            # Beacons between the last report and the end are in the recording only.
            assert sum(map(len, numbers.values())) >= each["beacons_sent"] + each["beacons_received"]

    def test_nothing_remains(self, runs):
        for name in list(runs.processes):
            runs.report(name)
        for process in runs.processes.values():
            assert not namespaces_of(process)
        assert not list(runs.directory.glob("*/*.sock"))


def test_two_processes_may_delete_the_same_namespaces(monkeypatch):
    # Workers of a matrix that start together all delete what an earlier one has left.
    real = namespaces.run

    def overtaken(command, given=""):
        if command[:3] == ["ip", "netns", "delete"]:
            real(command)
        return real(command, given)

    name = f"{namespaces.own_prefix()}-both"
    namespaces.create([name])
    monkeypatch.setattr(namespaces, "run", overtaken)
    namespaces.delete([name])
    assert namespaces.existing(namespaces.own_prefix()) == []


def test_a_namespace_that_cannot_be_deleted_is_reported(monkeypatch):
    real = namespaces.run

    def refused(command, given=""):
        if command[:3] == ["ip", "netns", "delete"]:
            raise namespaces.NamespaceError("ip netns delete: not permitted")
        return real(command, given)

    name = f"{namespaces.own_prefix()}-kept"
    namespaces.create([name])
    try:
        with monkeypatch.context() as patch:
            patch.setattr(namespaces, "run", refused)
            with pytest.raises(namespaces.NamespaceError, match="not permitted"):
                namespaces.delete([name])
    finally:
        namespaces.delete([name])


#: Bursts and corruption on all links, a direction that loses all, and links that change.
BAD_LINKS = """
nodes = 3
duration_s = 12
topology = "line"
link = { loss = 0.3, burst = 4, corrupt_frames = 0.1, flips = 2, delay_ms = 2, reorder = 0.05 }
[[links]]
from = 2
to = 1
both_ways = false
quality = { loss = 1 }
[[events]]
do = "create"
at_s = 1
node = 0
variable = 1
text = "a"
[[events]]
do = "link"
at_s = 8
quality = {}
[[expect]]
that = "variable"
node = 1
variable = 1
text = "a"
[[expect]]
that = "neighbours"
node = 1
are = []
"""


def test_links_that_the_kernel_cannot_impair_use_the_relay(tmp_path):
    """One node hears the other one of its ends only; corrupted frames arrive."""
    keep = tmp_path / "kept"
    scenario = written(tmp_path, "bad-links.toml", BAD_LINKS)
    process = start("--scenario", scenario, "--json", "--keep", keep)
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output + errors
    report = json.loads(output)
    sent = {each["node"]: each["beacons_sent"] for each in report["traffic"]}
    assert min(sent.values()) > 0
    assert not namespaces_of(process)
    own = {}
    for node in range(3):
        with open_capture(keep / f"node-{node}.mcap") as capture:
            own[node] = [(frame.data[6:12], frame.data) for frame in capture]
    addresses = [b"\x02" + node.to_bytes(5, "big") for node in range(3)]
    heard = {node: {source for source, _ in frames} - {addresses[node]} for node, frames in own.items()}
    assert heard == {0: {addresses[1]}, 1: {addresses[0]}, 2: {addresses[1]}}
    said = {data for source, data in own[0] if source == addresses[0]}
    got = [data for source, data in own[1] if source == addresses[0]]
    assert any(data not in said for data in got)


def test_the_kernel_refuses_such_links_without_the_relay(tmp_path):
    process = start("--scenario", written(tmp_path, "bad-links.toml", BAD_LINKS), "--links", "kernel")
    output, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, output) == (2, "")
    assert "--links relay" in errors
    assert not namespaces_of(process)
