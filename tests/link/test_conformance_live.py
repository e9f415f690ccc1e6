"""Our node as a process under test: over Ethernet and UDP, reset, restarted, killed, and gone afterwards."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from ipaddress import IPv4Address
from pathlib import Path

import pytest
from dcp_conformance.definitions.case import SANITY, Case, Kind, all_cases
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, UpperTesterError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.lower_tester.udp import DEFAULT_GROUP
from dcp_conformance.reference.namespace import Namespace, NamespaceError
from dcp_conformance.reference.process import ReferenceProcess, free_port, reference_process, wait_for
from dcp_conformance.sut.process import ProcessControl
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester.patience import Patience

from dcp_codec import Codec
from dcp_codec.common.processes import started_at
from dcp_codec.network import sockets

from ..waiting import PATIENCE, eventually

PERIOD_MS = 50


def ethernet_or_skip() -> None:
    """Skip without network namespaces; fail where all tools are promised."""
    try:
        Namespace(b"\x02\0\0\0\0\x09").close()
    except NamespaceError as error:
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(f"no virtual Ethernet: {error}", pytrace=False)
        pytest.skip(f"no virtual Ethernet: {error}")


@pytest.fixture(params=["ethernet", "udp"])
def node(request) -> Iterator[ReferenceProcess]:
    """A node on each kind of link."""
    if request.param == "ethernet":
        ethernet_or_skip()
    with reference_process(
        Codec("dcp-2.0"), beacon_period_ms=PERIOD_MS, link=request.param, patience=PATIENCE
    ) as running:
        yield running


def runner_for(node: ReferenceProcess, profile: str = "dcp-2.0") -> Runner:
    # Nothing here is quick or slow: what is waited for comes, however long the machine takes.
    pics = Pics(pixit=Testing(beacon_period_ms=PERIOD_MS, least_patience_ms=20_000))
    runner = Runner(Session(Codec(profile), node.lower, node.upper, pics), node.control)
    runner.prepare()
    return runner


def made_up(run, **keys) -> Case:
    """A case that is not in the suite."""
    return Case("TC_X", "x", ("BP-RX-01",), Kind.VALID, "", "", 1, "", __name__, run, **keys)


def pid_of(node: ReferenceProcess) -> int:
    process = node.control._process  # type: ignore[attr-defined]
    return int(process.pid)


def until_gone(pid: int) -> None:
    """Wait until a process has ended."""
    eventually(lambda: started_at(pid) is None, f"process {pid} ends")


def sent_by(node: ReferenceProcess) -> int:
    """Number of beacons that the node reports to have sent."""
    return int(node.upper.call("UT-Status", {}).result["node"]["bp"]["counters"]["beacons-sent"])


def test_cases_pass(node):
    runner = runner_for(node)
    assert runner.session.sut_id == b"\x02\0\0\0\0\x01"
    assert runner.session.parameters["BPPAR_BEACON_PERIOD"] == PERIOD_MS
    chosen = [each for each in all_cases().values() if each.id == SANITY or each.id.startswith("TC_BP_RX_BI_01")]
    assert len(chosen) >= 4
    for each in chosen:
        result = runner.run(each)
        assert (result.verdict, result.reason) == (Verdict.PASS, ""), each.id
        assert not result.killed


def test_the_node_is_reset_between_cases(node):
    runner = runner_for(node)
    known: list[int] = []

    def create(bench: Bench) -> None:
        known.append(len(bench.must("RTDB-DescribeDatabase").result["variables"]))
        bench.must("RTDB-Create", varId=9, repCnt=1, descr="x", value="01")
        bench.must("BP-RegisterProtocol", protId=77, name="x", maxPayloadSize=9, queueingMode="BP_QMODE_ONCE")
        peer = bench.peer()
        peer.send(peer.create(bench.var_id()))
        heard = bench.until(lambda heard: heard.beacon)
        bench.verdicts.check(heard, "a beacon")
        known.append(len(bench.must("RTDB-DescribeDatabase").result["variables"]))
        bench.must("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=333)
        protocols = bench.must("BP-ListRegisteredProtocols").result["protocols"]
        bench.verdicts.check(len(protocols) == 3, "three protocols", str(protocols))
        period = bench.must("BP-GetParameters").result["parameters"]["BPPAR_BEACON_PERIOD"]
        bench.verdicts.check(period == 333, "the parameter is set", str(period))

    for _ in range(3):
        result = runner.run(made_up(create))
        assert (result.verdict, result.reason) == (Verdict.PASS, "")
    assert known == [0, 2] * 3


def test_time_stamps_are_those_of_the_kernel(node):
    runner = runner_for(node)

    def wait(bench: Bench) -> None:
        bench.must("RTDB-Create", varId=9, repCnt=1, descr="x", value="01")

        def sent() -> int:
            return int(bench.call("UT-Status").result["node"]["bp"]["counters"]["beacons-sent"])

        # Frames wait until the node has sent 12 beacons.
        first = sent()
        eventually(lambda: sent() >= first + 12, "beacons are sent")
        late = bench.waiting.wait_ns(0)
        times = [each.time for each in late]
        bench.verdicts.check(len(times) >= 12, "beacons that waited", str(len(times)))
        # Also those of a node that was kept waiting are a quarter of a period apart.
        spread = times[-1] - times[0]
        bench.verdicts.check(spread >= 0.1 * 1e9, "are told apart in time", f"{spread} ns")
        dropped = bench.lower.health().dropped
        bench.verdicts.check(dropped == 0, "none is lost", f"{dropped} are")

    result = runner.run(made_up(wait))
    assert result.verdict is Verdict.PASS, result.reason


def test_a_restart_is_from_the_initial_state(node):
    before = pid_of(node)
    assert node.upper.call("RTDB-Create", {"varId": 9, "repCnt": 1, "descr": "x", "value": "01"}).ok
    node.control.restart()
    assert pid_of(node) != before
    until_gone(before)
    assert node.upper.call("RTDB-DescribeDatabase", {}).result["variables"] == []
    assert runner_for(node).run(all_cases()[SANITY]).verdict is Verdict.PASS


def test_a_case_that_crashes_the_node_is_named_and_the_next_one_runs(node):
    runner = runner_for(node)

    def kill(bench: Bench) -> None:
        os.kill(pid_of(node), signal.SIGKILL)
        bench.wait(2)
        bench.call("UT-Hello")

    result = runner.run(made_up(kill, destructive=True, robustness=True))
    assert (result.verdict, result.killed) == (Verdict.FAIL, True)
    assert any("signal SIGKILL" in check.observed for check in result.checks)
    # A machine that is busy adds a note about the time of reactions.
    assert [note for note in runner.notes if "died" in note] == ["the implementation died in TC_X and was restarted"]
    assert runner.run(all_cases()[SANITY]).verdict is Verdict.PASS


def test_a_node_that_hangs(node):
    """Stopped by a signal it is there, and does not answer."""
    upper = node.upper
    upper._patience = Patience(0.3)
    os.kill(pid_of(node), signal.SIGSTOP)
    with pytest.raises(UpperTesterError, match=r"UT-Hello was not answered within 0\.3 s"):
        upper.call("UT-Hello", {})
    assert node.control.alive() is True
    os.kill(pid_of(node), signal.SIGCONT)
    upper._patience = Patience(PATIENCE)
    assert upper.call("UT-Hello", {}).ok


def test_a_second_connection(node):
    second = node.upper.another()
    assert second is not None
    assert second.call("UT-Hello", {}).result == node.upper.call("UT-Hello", {}).result
    assert second.call("UT-Subscribe", {"variables": True}).ok
    assert node.upper.call("RTDB-Create", {"varId": 9, "repCnt": 1, "descr": "x", "value": "01"}).ok
    told = eventually(second.poll, "the second connection gets a notification")
    assert [(each.method, each.params["varId"]) for each in told] == [("UT-VariableChanged", 9)]
    assert node.upper.poll() == []
    second.close()


def test_the_node_describes_itself():
    ethernet_or_skip()
    with reference_process(Codec("dcp-2.0"), link="auto") as running:
        assert running.about == "virtual Ethernet, in a network namespace of its own"
        assert running.lower.name == "eth:dcp-tester"
        pid = pid_of(running)
        # The tester itself is where it was.
        assert Path("/proc/self/ns/net").readlink() != Path(f"/proc/{pid}/ns/net").readlink()
    until_gone(pid)


def test_concurrent_runs_do_not_hear_each_other():
    codec = Codec("student-2024")
    with (
        reference_process(codec, beacon_period_ms=PERIOD_MS, patience=PATIENCE) as one,
        reference_process(codec, beacon_period_ms=PERIOD_MS, patience=PATIENCE) as other,
    ):
        assert one.lower.name != other.lower.name
        for var_id, each in enumerate((one, other), 1):
            assert each.upper.call("RTDB-Create", {"varId": var_id, "repCnt": 1, "descr": "x", "value": "01"}).ok
        first = [sent_by(each) for each in (one, other)]
        for before, each in zip(first, (one, other), strict=True):
            eventually(lambda before=before, each=each: sent_by(each) >= before + 8, "beacons are sent")
        for var_id, each in enumerate((one, other), 1):
            variables = each.upper.call("RTDB-DescribeDatabase", {}).result["variables"]
            assert [variable["varId"] for variable in variables] == [var_id]


def test_runs_over_udp_have_a_port_each(inside):
    inside.ip("link", "set", "lo", "up")
    Path("/proc/sys/net/ipv4/ip_local_port_range").write_text("50000 50001")
    with sockets.open_udp_receiver(IPv4Address(DEFAULT_GROUP), 50000):
        assert {free_port() for _ in range(20)} == {50001}


def test_virtual_ethernet_without_privileges():
    """In a user namespace, where the system lets any user create one."""
    if os.geteuid() != 0:
        pytest.skip("the other tests here run without privileges already")
    keys = {"user": 65534, "group": 65534, "extra_groups": [], "cwd": "/", "text": True}
    environment = {**os.environ, "HOME": "/", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        trial = subprocess.run([sys.executable, "-c", ""], capture_output=True, check=False, **keys)
    except PermissionError:
        pytest.skip(f"only root can run {sys.executable}")
    if trial.returncode:
        pytest.skip(f"others cannot run {sys.executable}: {trial.stderr}")
    process, pid, folder, about = started("auto", env=environment, **{k: v for k, v in keys.items() if k != "text"})
    process.terminate()
    process.communicate(timeout=PATIENCE)
    until_gone(pid)
    assert not folder.exists()
    if about != "virtual Ethernet, in a network namespace of its own":
        # Some systems do not permit any user to.
        assert about.startswith("UDP multicast over the loopback interface (a namespace cannot be made here")


@pytest.mark.parametrize("profile", ["student-2024", "sim-2.0", "dcp-1.0"])
def test_other_profiles(profile):
    with reference_process(Codec(profile), beacon_period_ms=PERIOD_MS, patience=PATIENCE) as running:
        if profile == "student-2024":
            assert "the profile student-2024 has no frames of its own on Ethernet" in running.about
        assert runner_for(running, profile).run(all_cases()[SANITY]).verdict is Verdict.PASS


def test_a_node_that_does_not_start():
    with (
        pytest.raises(
            ConformanceError, match=r"our node does not run: it ended with exit status 2; its output: .*no-such"
        ),
        reference_process(Codec("dcp-2.0"), link="udp", options=["--neighbour-file", "/no-such-folder/x"]),
    ):
        pytest.fail("it runs")


#: Listens, and ends once a client has connected and asked.
LISTENS = """
import socket, sys
with socket.socket(socket.AF_UNIX) as listener:
    listener.bind(sys.argv[1])
    listener.listen()
    client = listener.accept()[0]
    client.recv(1)
    sys.exit("this will not do")
"""


def test_a_node_that_listens_and_then_does_not_start(tmp_path):
    """The error is its exit status and not a missing answer, however much later it ends on a busy machine."""
    path = tmp_path / "node.sock"
    control = ProcessControl(start=[sys.executable, "-c", LISTENS, str(path)], settle=0)
    control.start()
    try:
        with pytest.raises(ConformanceError, match=r"does not run: it ended with exit status 1; its output: .*not do"):
            wait_for(control, path)
    finally:
        control.close()


SCRIPT = """
import sys, time
from dcp_codec import Codec
from dcp_conformance.reference.process import reference_process
with reference_process(Codec("dcp-2.0"), link=sys.argv[1]) as running:
    print(running.control._process.pid, running.control._path.parent, running.about, flush=True)
    while True:
        running.lower.receive(running.lower.now() + 10**9)
"""


def started(link: str, **keys) -> tuple[subprocess.Popen[str], int, Path, str]:
    """The script in a process, and what it says: number of the node, its folder, and over what they talk."""
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, link], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **keys
    )
    assert process.stdout is not None
    pid, folder, about = process.stdout.readline().strip().split(" ", 2)
    return process, int(pid), Path(folder), about


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_remains_after_a_run(number):
    process, pid, folder, _ = started("auto")
    assert folder.is_dir()
    process.send_signal(number)
    process.communicate(timeout=PATIENCE)
    until_gone(pid)
    if number is signal.SIGKILL:
        # SIGKILL leaves no process that could remove it.
        shutil.rmtree(folder)
    assert not folder.exists()
    if number is signal.SIGTERM:
        assert process.returncode == 128 + signal.SIGTERM


def test_udp_without_ethernet(tmp_path):
    environment = {**os.environ, "PATH": str(tmp_path)}
    process, pid, _, about = started("auto", env=environment)
    assert about.startswith("UDP multicast over the loopback interface (the command ip is not installed")
    process.terminate()
    process.communicate(timeout=PATIENCE)
    until_gone(pid)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, "ethernet"], env=environment, capture_output=True, text=True, check=False
    )
    assert "ConformanceError: no virtual Ethernet for our node: the command ip is not installed" in done.stderr
