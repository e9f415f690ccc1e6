"""Live capture on a real packet socket, at one end of a virtual cable."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from dcp_codec.capture import Frame
from dcp_codec.common.extras import advice

from ..waiting import PATIENCE, eventually

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")
pytestmark = pytest.mark.tool("ip")

LISTEN = """
import json, signal, sys, threading
from dcp_codec.network.live import LiveError, LiveReader
from dcp_spec.profile.definition import Link

link = json.loads(sys.argv[2])
try:
    reader = LiveReader(sys.argv[1], None if link is None else Link(**link))
except LiveError as error:
    print(json.dumps({"error": str(error)}))
    sys.exit(0)
signal.signal(signal.SIGTERM, lambda *_: reader.close())
threading.Thread(target=lambda: (sys.stdin.readline(), reader.close()), daemon=True).start()
with reader:
    print(json.dumps({"ready": reader.name}))
    for frame in reader:
        data = frame.data.hex()
        print(json.dumps([frame.number, frame.time_ns, frame.orig_len, data, frame.interface, frame.offset]))
    reader.close()
print(json.dumps({"ended": reader.frames_read, "dropped": reader.dropped}))
"""

SEND = """
import json, sys
from scapy.arch.linux import L2Socket
from scapy.packet import Raw

out = L2Socket(iface=sys.argv[1])
print("ready")
for line in sys.stdin:
    frames = json.loads(line)
    for data in frames:
        out.send(Raw(bytes.fromhex(data)))
    print(len(frames))
"""

ETHERNET = {"transport": "ethernet", "ether_type": 0x4953}
UDP = {"transport": "udp", "udp_port": 5950}


@dataclass
class Listener:
    """The process that listens, and what it said."""

    process: Any

    def frame(self) -> Frame:
        number, time_ns, orig_len, data, interface, offset = json.loads(self.process.line())
        return Frame(number, time_ns, bytes.fromhex(data), orig_len, interface, offset)

    def hears_nothing(self) -> bool:
        return self.process.line_or_none(0.3) is None

    def stop(self) -> dict[str, int]:
        self.process.say("stop")
        return self.end()

    def end(self) -> dict[str, int]:
        found: dict[str, int] = json.loads(self.process.line())
        assert self.process.popen.wait(PATIENCE) == 0
        return found


@dataclass
class Sender:
    """The process that sends."""

    process: Any

    def send(self, *frames: bytes) -> None:
        self.process.say(json.dumps([frame.hex() for frame in frames]))
        assert self.process.line() == str(len(frames))


def listen(namespace: Any, link: dict[str, Any] | None = ETHERNET, interface: str = "near") -> Listener:
    process = namespace.python(LISTEN, interface, json.dumps(link))
    assert json.loads(process.line()) == {"ready": interface}
    return Listener(process)


def sender(namespace: Any, interface: str = "far") -> Sender:
    process = namespace.python(SEND, interface)
    assert process.line() == "ready"
    return Sender(process)


def frame(ether_type: int, content: bytes, *tags: tuple[int, int]) -> bytes:
    """An Ethernet frame; ``tags`` are (tag type, tag) from the outside."""
    tagged = b"".join(number.to_bytes(2, "big") for tag in tags for number in tag)
    return b"\xff" * 6 + bytes.fromhex("020000000001") + tagged + ether_type.to_bytes(2, "big") + content


def failure(namespace: Any, interface: str, before: str = "") -> str:
    found = json.loads(namespace.python(before + LISTEN, interface, json.dumps(ETHERNET)).line())
    return str(found["error"])


# -- what arrives -------------------------------------------------------------------------------------------------


def test_frames_arrive_whole_in_order_and_stamped(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    sent = [frame(0x4953, bytes([number % 256]) * (46 + 7 * number)) for number in range(200)]
    before = time.time_ns()
    far.send(*sent)
    after = time.time_ns()
    arrived = [listener.frame() for _ in sent]
    assert [each.data for each in arrived] == sent
    assert [each.number for each in arrived] == list(range(1, 201))
    assert all(each.orig_len == len(each.data) for each in arrived)
    assert {(each.interface, each.offset) for each in arrived} == {(0, -1)}
    stamps = [each.time_ns for each in arrived]
    assert stamps == sorted(stamps)
    assert before <= stamps[0]
    assert stamps[-1] <= after
    # Nanoseconds that went through a float would all be multiples of 256.
    assert any(stamp % 256 for stamp in stamps)
    assert listener.stop() == {"ended": 200, "dropped": 0}


def test_only_the_ether_type_passes(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    wanted = [
        frame(0x4953, b"plain" + bytes(60)),
        frame(0x4953, b"tagged" + bytes(60), (0x8100, 5)),
        frame(0x4953, b"priority" + bytes(60), (0x8100, 0)),
        frame(0x4953, b"twice" + bytes(60), (0x88A8, 7), (0x8100, 5)),
    ]
    others = [
        frame(0x0800, bytes(60)),
        frame(0x0806, bytes(60)),
        frame(0x4954, bytes(60)),
        frame(0x5349, bytes(60)),
        frame(0x0806, b"\x49\x53" * 30),
        frame(0x0806, bytes(60), (0x8100, 5)),
        frame(60, b"\x49\x53" * 30),
    ]
    for each in wanted:
        far.send(*others, each)
    assert [listener.frame().data for _ in wanted] == wanted
    assert listener.stop()["ended"] == len(wanted)


def test_udp_links_receive_all_ip_traffic(namespace: Any) -> None:
    listener, far = listen(namespace, UDP), sender(namespace)
    wanted = [frame(0x0800, b"E" + bytes(60)), frame(0x86DD, b"`" + bytes(60)), frame(0x0800, bytes(60), (0x8100, 9))]
    for each in wanted:
        far.send(frame(0x4953, bytes(60)), frame(0x0806, bytes(60)), each)
    assert [listener.frame().data for _ in wanted] == wanted


def test_without_a_link_everything_passes(namespace: Any) -> None:
    listener, far = listen(namespace, None), sender(namespace)
    sent = [frame(ether_type, bytes(60)) for ether_type in (0x4953, 0x0806, 0x0800, 60)]
    far.send(*sent)
    assert [listener.frame().data for _ in sent] == sent


def test_own_frames_are_seen(namespace: Any) -> None:
    listener, near = listen(namespace), sender(namespace, "near")
    near.send(frame(0x4953, bytes(60)), frame(0x0806, bytes(60)), frame(0x4953, b"\1" + bytes(60)))
    assert [listener.frame().data[14] for _ in range(2)] == [0, 1]


def test_frames_for_other_stations_are_seen(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    other = bytes.fromhex("0200000000ee") + frame(0x4953, bytes(60))[6:]
    far.send(other)
    assert listener.frame().data == other


def test_loopback_frames_are_seen_once(namespace: Any) -> None:
    namespace.ip("link", "set", "lo", "up")
    listener, out = listen(namespace, ETHERNET, "lo"), sender(namespace, "lo")
    out.send(frame(0x4953, b"\1" + bytes(60)), frame(0x4953, b"\2" + bytes(60)))
    assert [listener.frame().data[14] for _ in range(2)] == [1, 2]
    assert listener.hears_nothing()


def test_frames_that_are_not_read_in_time_are_counted(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    listener.process.popen.send_signal(signal.SIGSTOP)
    sent = 0
    try:
        for _ in range(50):
            far.send(*[frame(0x4953, bytes(1400))] * 500)
            sent += 500
    finally:
        listener.process.popen.send_signal(signal.SIGCONT)
    heard, lasts = False, 0
    while not heard:
        # While the queue is full the last one is dropped, too.
        far.send(frame(0x4953, b"last" + bytes(60)))
        lasts += 1
        assert lasts < 100
        while (line := listener.process.line_or_none(0.5)) is not None and not heard:
            heard = b"last".hex() in line
    listener.process.say("stop")
    while (line := listener.process.line()).startswith("["):
        pass
    ended = json.loads(line)
    # The drops counted by the kernel are the missing frames; only some of the last ones may still have been queued.
    assert 0 <= sent + lasts - ended["ended"] - ended["dropped"] - namespace.lost_on_the_cable() < lasts
    # Some thousand beacons wait without a loss.
    assert 1000 < ended["ended"] < sent
    assert ended["dropped"] > 1000


# -- how it ends --------------------------------------------------------------------------------------------------


def test_a_signal_handler_can_end_the_capture(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    far.send(frame(0x4953, bytes(60)))
    listener.frame()
    listener.process.popen.send_signal(signal.SIGTERM)
    assert listener.end() == {"ended": 1, "dropped": 0}


def test_closing(namespace: Any) -> None:
    process = namespace.python(
        """
import gc, os, threading, warnings
warnings.simplefilter("error")
from dcp_codec.network.live import LiveReader
LiveReader("near", None).close()
before = len(os.listdir("/proc/self/fd"))
for when in ("before", "while", "never read"):
    reader = LiveReader("near", None)
    with reader:
        if when == "before":
            reader.close()
        if when == "while":
            threading.Timer(0.1, reader.close).start()
        if when != "never read":
            print(when, list(reader), reader.problems, reader.format)
    reader.close()
    try:
        next(reader)
    except StopIteration:
        print("stays closed", reader.dropped)
gc.collect()
print(len(os.listdir("/proc/self/fd")) - before)
"""
    )
    found = [process.line() for _ in range(6)]
    assert found == [
        "before [] [] live",
        "stays closed 0",
        "while [] [] live",
        "stays closed 0",
        "stays closed 0",
        "0",
    ]
    assert process.popen.wait(PATIENCE) == 0


# -- interfaces that come and go ----------------------------------------------------------------------------------


def test_an_interface_may_go_down_and_come_back(namespace: Any) -> None:
    listener, far = listen(namespace), sender(namespace)
    far.send(frame(0x4953, b"one" + bytes(60)))
    assert b"one" in listener.frame().data
    for _ in range(2):
        namespace.ip("link", "set", "near", "down")
        assert listener.hears_nothing()
        namespace.ip("link", "set", "near", "up")
        namespace.wait_for_carrier()
        far.send(frame(0x4953, b"two" + bytes(60)))
        assert b"two" in listener.frame().data
    namespace.ip("link", "set", "near", "down")
    assert listener.hears_nothing()
    assert listener.stop() == {"ended": 3, "dropped": 0}


def test_an_interface_may_be_unplugged_and_plugged_in_again(namespace: Any) -> None:
    listener = listen(namespace)
    sender(namespace).send(frame(0x4953, b"one" + bytes(60)))
    assert b"one" in listener.frame().data
    namespace.ip("link", "delete", "near")
    assert listener.hears_nothing()
    namespace.cable()
    far = sender(namespace)

    def heard() -> bool:
        far.send(frame(0x4953, b"two" + bytes(60)), frame(0x0806, bytes(60)))
        return listener.process.line_or_none(0.2) is not None

    eventually(heard, "frames arrive again")
    listener.process.say("stop")
    while (line := listener.process.line()).startswith("["):
        assert b"two".hex() in line
    assert json.loads(line)["dropped"] == 0


# -- what cannot be -----------------------------------------------------------------------------------------------


def test_no_such_interface(namespace: Any) -> None:
    message = failure(namespace, "uwb0")
    assert message.startswith("uwb0: there is no such interface; there are ")
    assert "near" in message
    assert "far" in message


def test_an_interface_that_is_down(namespace: Any) -> None:
    namespace.ip("link", "set", "near", "down")
    assert failure(namespace, "near") == ("near: the interface is down; bring it up first: ip link set near up")


def test_no_privilege(namespace: Any) -> None:
    # Still root, as the checkout may be unreadable for other users, but without capabilities: capset(2), version 3.
    drop = "ctypes.CDLL(None).capset((ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)())"
    message = failure(namespace, "near", f"import ctypes\nassert {drop} == 0\n")
    assert message.startswith("near: this needs the right to open raw sockets: run as root, or ")
    assert "sudo setcap cap_net_raw+ep" in message
    # All users share the interpreter of the system.
    assert str(Path(sys.executable).resolve()) not in message


def test_no_scapy(namespace: Any) -> None:
    message = failure(namespace, "near", "import sys; sys.modules['scapy'] = None\n")
    assert message == f"near: {advice('scapy')}"


def test_frames_that_are_not_ethernet(namespace: Any) -> None:
    made = subprocess.run(
        ["ip", "-n", namespace.name, "tuntap", "add", "dev", "tun7", "mode", "tun"], capture_output=True, check=False
    )
    if made.returncode != 0 and os.environ.get("DCP_REQUIRE_TOOLS") != "1":
        pytest.skip("there are no tun interfaces here")
    namespace.ip("link", "set", "tun7", "up")
    assert "tun7: frames there are not Ethernet (hardware type 65534)" in failure(namespace, "tun7")


def test_the_command(namespace: Any) -> None:
    process = namespace.python(
        "import sys; from dcp_codec.cli import main; sys.argv = ['dcp-codec', *sys.argv[1:]]; main()",
        *("decode", "--interface", "near", "--profile", "dcp-2.0", "--format", "jsonl", "--count", "2"),
    )
    from dcp_codec import Beacon, BPHeader, Payload, get_codec

    far = sender(namespace)
    sender_id = bytes.fromhex("020000000001")
    octets = get_codec("dcp-2.0").encode(Beacon(BPHeader(sender_id, 41, 0x1111), (Payload(9, b"abc"),)))

    def heard() -> bool:
        # It says on standard error when it listens; sending until it hears is as good.
        far.send(frame(0x4953, octets))
        return process.line_or_none(0.2) is not None

    eventually(heard, "a frame arrives")
    far.send(frame(0x4953, octets))
    assert json.loads(process.line())["bp"]["seqno"] == 41
    assert process.popen.wait(PATIENCE) == 0


def test_recording_ends_with_a_whole_file_on_sigterm(namespace: Any, tmp_path: Any) -> None:
    from dcp_codec.capture import open_capture

    out = tmp_path / "flight.pcapng.zst"
    process = namespace.python(
        "import sys; from dcp_codec.cli import main; sys.argv = ['dcp-codec', *sys.argv[1:]]; main()",
        *("record", "--interface", "near", "--ether-type", "0x4953", "--out", str(out)),
    )
    far = sender(namespace)

    def begun() -> bool:
        far.send(frame(0x4953, b"content"))
        far.send(frame(0x88B5, b"other traffic"))
        # A file whose recorder has not begun to listen is empty.
        return out.exists() and process.popen.poll() is None

    eventually(begun, "the file is created")
    for _ in range(20):
        far.send(frame(0x4953, b"content"))
        time.sleep(0.05)
    process.popen.terminate()
    assert process.popen.wait(PATIENCE) == 0
    with open_capture(out) as reader:
        frames = list(reader)
        assert reader.problems == []
    assert len(frames) >= 10
    assert all(each.data[12:21] == b"\x49\x53content" for each in frames)
