"""Starting, watching, restarting and ending an implementation."""

from __future__ import annotations

import itertools
import os
import re
import select
import shlex
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.sut import process as keeper
from dcp_conformance.sut.process import ProcessControl
from dcp_conformance.upper_tester.channels import split

from dcp_codec.common.processes import started_at

from ..ports import own_port
from ..waiting import PATIENCE, eventually


def program(tmp_path: Path, code: str, name: str = "sut") -> str:
    """A command that runs this code; ``here`` is a folder to leave traces in."""
    path = tmp_path / f"{name}.py"
    path.write_text(f"import os, signal, sys, time\nfrom pathlib import Path\nhere = Path({str(tmp_path)!r})\n{code}\n")
    return f"{shlex.quote(sys.executable)} {path}"


FOREVER = "(here / 'pid').write_text(str(os.getpid()))\ntime.sleep(600)"


def pid_in(tmp_path: Path) -> int:
    """The process that has left its number."""
    path = tmp_path / "pid"
    eventually(lambda: path.exists() and path.read_text(), "the program leaves its number")
    return int(path.read_text())


@pytest.fixture
def control():
    """Makes controls, and closes them."""
    made: list[ProcessControl] = []

    def make(*arguments, **keys) -> ProcessControl:
        made.append(ProcessControl(*arguments, **keys))
        return made[-1]

    yield make
    for each in made:
        each.close()
        each.close()


FAULTY = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
static int parse(const unsigned char *octets, int length) {
    unsigned char *copy = malloc(8);
    memcpy(copy, octets, length);
    return copy[7];
}
static int shifted(int by) { return 1 << by; }
int main(int argc, char **argv) {
    static unsigned char frame[64];
    while (access(argv[1], F_OK)) usleep(1000);
    if (!strcmp(argv[2], "copy")) return parse(frame, 20);
    if (!strcmp(argv[2], "free")) { char *copy = malloc(4); free(copy); return copy[argc - 3]; }
    if (!strcmp(argv[2], "shift")) { printf("%d\\n", shifted(argc + 40)); abort(); }
    return 3;
}
"""
#: By fault: what its finding quotes. No line of the report of ``copy`` but the stack has the place in the program.
QUOTED = {
    "copy": r"ERROR: \w+: heap-buffer-overflow on address \w+, WRITE of size 20, in parse \S*node\.c:8; its",
    "free": r"ERROR: AddressSanitizer: heap-use-after-free on address \w+, READ of size 1, in main \S*node\.c:16; its",
    "shift": r"node\.c:11:\d+: runtime error: shift exponent 43 is too large for 32-bit type 'int'; its",
}


@pytest.mark.tool("gcc")
def test_a_report_of_a_sanitizer_is_quoted_by_its_first_line_and_the_place_in_the_source(tmp_path):
    (tmp_path / "node.c").write_text(FAULTY)
    command = "gcc -w -g -O0 -fno-omit-frame-pointer -fsanitize=address,undefined node.c -o node"
    subprocess.run(command.split(), cwd=tmp_path, check=True)
    # The process must not end before start() has checked it.
    started = tmp_path / "started"
    for fault, quoted in QUOTED.items():
        started.unlink(missing_ok=True)
        it = ProcessControl(
            start=[str(tmp_path / "node"), str(started), fault], settle=0, log=tmp_path / f"{fault}.txt"
        )
        it.start()
        started.touch()
        eventually(lambda it=it: it.alive() is False, "it ends")
        assert re.search(quoted, it.why_dead()), it.why_dead()
        it.close()
    # The file has all of it.
    assert "==ERROR: AddressSanitizer" in (tmp_path / "copy.txt").read_text()


def test_the_output_of_an_earlier_life_is_not_quoted(tmp_path):
    code = "first = not (here / 'lived').exists(); (here / 'lived').touch()\n"
    code += "while not (here / 'end').exists(): time.sleep(0.01)\n"
    code += "print('ERROR: AddressSanitizer: of the first life' if first else 'second', flush=True); sys.exit(1)"
    it = ProcessControl(start=program(tmp_path, code), settle=0, log=tmp_path / "output.txt")
    it.start()
    (tmp_path / "end").touch()
    eventually(lambda: it.alive() is False, "it ends")
    assert "of the first life" in it.why_dead()
    (tmp_path / "end").unlink()
    it.restart()
    (tmp_path / "end").touch()
    eventually(lambda: it.alive() is False, "it ends")
    assert it.why_dead() == "it ended with exit status 1; its output: second"
    it.close()


def test_a_process_is_started_watched_and_ended(tmp_path, control):
    it = control(start=program(tmp_path, FOREVER), settle=0)
    assert it.can_restart
    # Nothing is started before it is wanted.
    assert it.alive() is None
    it.start()
    pid = pid_in(tmp_path)
    assert (it.alive(), it.why_dead()) == (True, "")
    it.close()
    assert started_at(pid) is None


@pytest.mark.parametrize(
    ("end", "why"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "it ended with signal SIGSEGV"),
        ("sys.exit('no memory')", "it ended with exit status 1; its output: .*no memory"),
        ("sys.exit(0)", "it ended with exit status 0; its output: hello"),
        ("raise KeyError('seqno')", "exit status 1; its output: .*KeyError: 'seqno'"),
    ],
)
def test_a_crash_is_reported_with_its_reason(tmp_path, control, end, why):
    code = f"print('hello', flush=True)\nwhile not (here / 'end').exists(): time.sleep(0.01)\n{end}"
    it = control(start=program(tmp_path, code), settle=0)
    it.start()
    assert it.alive()
    (tmp_path / "end").touch()
    eventually(lambda: it.alive() is False, "it dies")
    assert re.search(why, it.why_dead())
    (tmp_path / "end").unlink()
    it.restart()
    assert (it.alive(), it.why_dead()) == (True, "")


def test_the_last_output_is_bounded(tmp_path, control):
    code = "print('x' * 100, flush=True)\nfor n in range(100000): print('line', n)\nsys.stdout.flush(); sys.exit(2)"
    it = control(start=program(tmp_path, f"while not (here / 'end').exists(): time.sleep(0.01)\n{code}"))
    it.start()
    (tmp_path / "end").touch()
    eventually(lambda: it.alive() is False, "it dies")
    assert "line 99999" in it.why_dead()
    assert len(it.why_dead()) < 6000


def test_disk_space_of_old_output_is_freed_without_truncating_the_file(tmp_path, control):
    """Truncating it would lose output that is written between reading and truncating."""
    it = control(start=program(tmp_path, "time.sleep(60)"), settle=0)
    it.start()
    assert it._process is not None
    said = b"x" * 101 + b"\n" + b"line\n" * 2_000_000 + b"the last line\n"
    os.write(it._process._output.fileno(), said)
    assert it.alive() is True
    status = os.fstat(it._process._output.fileno())
    assert status.st_size == len(said)
    assert status.st_blocks * 512 < 1_000_000
    assert "the last line" in it._process.last_lines()


def test_much_output_does_not_fill_the_disk(tmp_path, control):
    code = "block = 'y' * 65535 + chr(10)\nwhile True: print(block, flush=True); time.sleep(0.001)"
    it = control(start=program(tmp_path, code), settle=0)
    it.start()
    assert it._process is not None
    taken = []

    def given_back() -> bool:
        assert it.alive()
        taken.append(os.fstat(it._process._output.fileno()).st_blocks * 512)
        return sum(later < earlier for earlier, later in itertools.pairwise(taken)) > 2

    eventually(given_back, "room is given back, again and again")
    assert os.fstat(it._process._output.fileno()).st_size > 2_000_000
    assert min(taken[1:]) < 1_000_000


def test_a_command_that_fails_at_once(tmp_path, control):
    it = control(start=program(tmp_path, "sys.exit('no such interface')"), settle=PATIENCE)
    with pytest.raises(ConformanceError, match="ended at once with exit status 1; its output: no such interface"):
        it.start()


def test_a_launcher(tmp_path, control):
    """A command that starts a service and ends."""
    service = program(tmp_path, FOREVER, "service")
    launch = f"import subprocess\nsubprocess.Popen({shlex.split(service)!r}, start_new_session=True)"
    stop = f"kill {'$'}(cat {tmp_path}/pid); rm {tmp_path}/pid"
    it = control(start=program(tmp_path, launch, "launch"), stop=stop, settle=PATIENCE)
    it.start()
    first = pid_in(tmp_path)
    assert it.alive() is None
    it.restart()
    second = pid_in(tmp_path)
    assert second != first
    # The command that stops it does not wait for its end.
    eventually(lambda: started_at(first) is None, "the first one ends")
    assert it.alive() is None
    assert control(pid=second).alive() is True
    # Without a process to watch, the cause is unknown.
    blind = control(start="true", settle=PATIENCE)
    blind.start()
    assert (blind.alive(), blind.why_dead()) == (None, "")


@pytest.mark.parametrize("stubborn", [False, True])
def test_detached_children_of_a_launcher_are_ended(tmp_path, control, stubborn):
    """Without a command that stops it, a restart would leave two of them on the link."""
    ignore = "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" if stubborn else ""
    service = program(tmp_path, ignore + FOREVER, "service")
    launch = f"import subprocess\nsubprocess.Popen({shlex.split(service)!r}, start_new_session=True)"
    it = control(start=program(tmp_path, launch, "launch"), settle=PATIENCE)
    it.start()
    first = pid_in(tmp_path)
    (tmp_path / "pid").unlink()
    it.restart()
    assert started_at(first) is None
    second = pid_in(tmp_path)
    it.close()
    assert started_at(second) is None


#: Holds memory whose release takes the kernel some ms, and a UDP port that is free again when all of that is over.
LARGE = """
import socket
memory = b"x" * 100_000_000
held = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
held.bind(("127.0.0.1", int(sys.argv[1])))
(here / "new").write_text(str(os.getpid()))
(here / "new").rename(here / "pid")
time.sleep(600)
"""


def port_is_free(port: int) -> bool:
    """Whether a UDP port can be bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@pytest.mark.parametrize("stubborn", [False, True])
def test_nothing_of_a_large_detached_process_is_left_after_its_end(tmp_path, control, monkeypatch, stubborn):
    """100 ends by SIGTERM, 100 by SIGKILL: the kernel removes the environment of a process before it closes sockets."""
    monkeypatch.setattr(keeper, "END_PATIENCE", 0.1 if stubborn else PATIENCE)
    ignore = "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" if stubborn else ""
    port = own_port()
    it = control(start=f"setsid {program(tmp_path, ignore + LARGE)} {port} & true", settle=PATIENCE)
    left: list[str] = []
    for turn in range(100):
        it.start()
        descriptor = os.pidfd_open(pid_in(tmp_path))
        (tmp_path / "pid").unlink()
        it._end()
        free = port_is_free(port)
        if not free or not select.select([descriptor], [], [], 0)[0]:
            left.append(f"turn {turn}: {'it runs' if free else 'its port is in use'}")
            select.select([descriptor], [], [], PATIENCE)
        os.close(descriptor)
    assert not left, f"{len(left)} of 100: {left[:5]}"


def test_processes_started_during_the_end_are_ended(tmp_path, control):
    """Each service starts its successor in another session on SIGTERM."""
    service = (
        "import subprocess\nnumber = int(sys.argv[1])\n"
        "def succeed(*_):\n"
        "    if number < 5: subprocess.Popen([sys.executable, __file__, str(number + 1)], start_new_session=True)\n"
        "    os._exit(0)\n"
        "signal.signal(signal.SIGTERM, succeed)\n"
        "with (here / 'log').open('a') as log: print(os.getpid(), file=log)\n"
        "(here / 'pid').write_text(str(os.getpid()))\ntime.sleep(600)"
    )
    it = control(start=f"setsid {program(tmp_path, service, 'service')} 1 & true", settle=PATIENCE)
    it.start()
    pid_in(tmp_path)
    it.close()
    started = [int(line) for line in (tmp_path / "log").read_text().split()]
    assert not [pid for pid in started if started_at(pid) is not None]
    assert not it._started.running()


def test_a_launcher_on_a_busy_machine(tmp_path, control):
    """It ends with status 0 long after the settling time: what it has launched is not dead."""
    service = program(tmp_path, FOREVER, "service")
    launch = (
        f"import subprocess\nsubprocess.Popen({shlex.split(service)!r}, start_new_session=True)\n"
        "while not (here / 'go').exists(): time.sleep(0.01)"
    )
    it = control(start=program(tmp_path, launch, "launch"), stop=f"kill $(cat {tmp_path}/pid)", settle=0.01)
    it.start()
    pid_in(tmp_path)
    assert it.alive() is True
    (tmp_path / "go").touch()
    eventually(lambda: it.alive() is None, "the launcher ends")
    assert it.why_dead() == ""


def test_a_program_that_ends_with_its_node_is_dead_although_its_adapter_runs(tmp_path, control):
    """It ends with status 0, as a launcher does, but so has the process on the link that it had started."""
    port = own_port()
    bind = f"import socket\nlink = socket.socket(type=socket.SOCK_DGRAM)\nlink.bind(('127.0.0.1', {port}))\n"
    adapter = program(tmp_path, "time.sleep(600)", "adapter")
    node = program(tmp_path, bind + FOREVER, "node")
    both = f"import subprocess\nsubprocess.Popen({shlex.split(adapter)!r})\nsubprocess.call({shlex.split(node)!r})"
    it = control(start=program(tmp_path, both, "both"), settle=0.01, udp_port=port)
    it.start()
    pid = pid_in(tmp_path)
    eventually(it.on_link, "it opens the link")
    assert it.alive() is True
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: it.alive() is False, "the node has ended")
    assert it.why_dead() == "it ended with exit status 0; it wrote nothing"
    assert it._started.running()


def test_a_program_that_exits_with_status_0_is_dead(tmp_path, control):
    """Status 0 after the settling time, and nothing that it has started is left."""
    code = "while not (here / 'go').exists(): time.sleep(0.01)"
    it = control(start=program(tmp_path, code), settle=0.01)
    it.start()
    assert it.alive() is True
    (tmp_path / "go").touch()
    eventually(lambda: it.alive() is False, "it ends")
    assert it.why_dead() == "it ended with exit status 0; it wrote nothing"


def test_restarting_by_a_command(tmp_path, control):
    calls = []
    it = control(restart=f"echo again >> {tmp_path}/log && echo ok")
    it.after_restart.append(lambda: calls.append(1))
    assert it.can_restart
    assert it.alive() is None
    it.restart()
    it.restart()
    assert (tmp_path / "log").read_text() == "again\nagain\n"
    assert calls == [1, 1]
    failing = control(restart="echo 'unit not found' >&2; exit 5")
    with pytest.raises(
        ConformanceError, match="--restart: the command ended with exit status 5; its output: unit not found"
    ):
        failing.restart()
    missing = control(restart="/no/such/program")
    with pytest.raises(UsageError, match="--restart: /no/such/program cannot be started: No such file"):
        missing.restart()
    nothing = control()
    assert not nothing.can_restart
    with pytest.raises(ConformanceError, match="no command to restart"):
        nothing.restart()


def test_watching_a_process(control):
    with subprocess.Popen(["sleep", "600"]) as other:
        it = control(pid=other.pid)
        assert (it.alive(), it.can_restart) == (True, False)
        other.kill()
        # Before it is waited for it is still there, and dead.
        eventually(lambda: it.alive() is False, "it is dead")
        assert it.why_dead() == f"process {other.pid} is gone"
    with pytest.raises(UsageError, match=f"--pid {other.pid}: there is no such process"):
        control(pid=other.pid)


def test_a_reused_pid_is_another_process(control):
    last = Path("/proc/sys/kernel/ns_last_pid")
    with subprocess.Popen(["sleep", "600"]) as first:
        it = control(pid=first.pid)
        first.kill()

    def again() -> bool:
        """Whether the number is that of another process; anything may start in between."""
        last.write_text(str(first.pid - 1))
        with subprocess.Popen(["true"]) as second:
            return second.pid == first.pid and it.alive() is False and started_at(first.pid) is not None

    if not os.access(last, os.W_OK):
        pytest.skip("the next number of a process cannot be chosen here")
    eventually(again, "the number is used again")


def test_children_that_ignore_sigterm_are_ended(tmp_path, control):
    code = (
        "import subprocess\nchild = subprocess.Popen(['sleep', '600'])\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n(here / 'pid').write_text(str(child.pid))\ntime.sleep(600)"
    )
    it = control(start=program(tmp_path, code), settle=0)
    it.start()
    child = pid_in(tmp_path)
    begun = time.monotonic()
    it.close()
    # It takes no notice of SIGTERM, and its child has never heard of it.
    assert time.monotonic() - begun < PATIENCE
    eventually(lambda: started_at(child) is None, "the child ends")


def test_the_implementation_ends_even_if_the_tester_is_killed(tmp_path):
    inner = program(tmp_path, FOREVER, "inner")
    outer = (
        "from dcp_conformance.sut.process import ProcessControl\n"
        f"it = ProcessControl(start={inner!r}, ends_with_tester=True, settle=0)\nit.start()\ntime.sleep(600)"
    )
    with subprocess.Popen(shlex.split(program(tmp_path, outer, "outer"))) as tester:
        pid = pid_in(tmp_path)
        tester.kill()
    eventually(lambda: started_at(pid) is None, "it ends with the tester")


def test_commands():
    assert split("--start", "a 'b c' --d=e/f") == ["a", "b c", "--d=e/f"]
    for command in ("a | b", "a && b", "x=1 a", "a > b", "echo $HOME", "a; b", "a *"):
        assert split("--start", command) == ["/bin/sh", "-c", command]
    for command, message in (("", "which command"), ("a 'b", "No closing quotation")):
        with pytest.raises(UsageError, match=message):
            split("--start", command)
