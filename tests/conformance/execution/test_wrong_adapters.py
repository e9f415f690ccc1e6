"""Faults of an adapter are reported as the adapter's, and no requirement of the implementation fails for them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import Notification, contract, examination
from dcp_conformance.upper_tester.channels import Channel
from dcp_conformance.upper_tester.examination import Examination
from dcp_conformance.upper_tester.stream import StreamUpperTester

from dcp_codec.common.child import LastLines
from dcp_stack.virtual.world import EPOCH

from ..rig import codec_of, known_cases

Message = dict[str, Any]
PROFILE = "dcp-2.0"
#: Cases that use what the adapters get wrong.
CASES = (
    "TC_DCP_SANITY_BV_01",
    "TC_VD_CRE_BV_01",
    "TC_VD_REA_BV_01",
    "TC_VD_DDB_BV_01",
    "TC_VD_DVA_BV_02-own",
    "TC_BP_CLR_BV_01-once",
    "TC_BP_QM_BV_01",
    "TC_BP_DRG_BO_01",
    "TC_BP_LST_BV_01",
    "TC_BP_PAR_BV_01-period",
    "TC_SRP_NT_BV_01",
)


class NodeChannel(Channel):
    """Lines to and from a node in this process, with an adapter in between."""

    def __init__(self, sut: InProcess, adapter: Adapter) -> None:
        super().__init__("adapter")
        self._sut, self._adapter = sut, adapter
        self._session = sut.server.open()
        self._output: deque[bytes] = deque()

    def filenos(self) -> tuple[int, ...]:
        return ()

    def _write_fileno(self) -> int:
        raise NotImplementedError

    def _write(self, octets: memoryview) -> int:
        raise NotImplementedError

    def _read(self) -> bytes | None:
        waiting = bytes(self._session.output)
        self._session.sent(len(waiting))
        for line in waiting.splitlines():
            self._output.append(self._adapter.line(msgspec.json.decode(line)))
        return self._output.popleft() if self._output else None

    def send(self, octets: bytes, deadline: float) -> None:
        request = msgspec.json.decode(octets)
        sut = self._sut
        if (answer := self._adapter.instead(request)) is not None:
            self._output.append(msgspec.json.encode(answer) + b"\n")
            return
        lines: list[bytes] = []
        sut.guarded(lambda: lines.append(self._session.feed(octets, now=sut.now, wall=sut.wall())))
        if sut.died:
            raise UpperTesterError(f"the node has ended: {sut.died}")
        for line in b"".join(lines).splitlines():
            self._output.append(self._adapter.line(self._adapter.answered(request, msgspec.json.decode(line))))

    def close(self) -> None:
        self._ended = True

    def end_description(self) -> str:
        return "closed"


class Adapter:
    """An adapter without a fault. Subclasses change messages."""

    tells: str = ""
    """A part of what is reported about it; empty if nothing is."""

    def instead(self, request: Message) -> Message | None:
        """Return an answer that does not come from the node."""
        return None

    def answered(self, request: Message, message: Message) -> Message:
        """Return the answer to a request."""
        if "result" in message:
            message["result"] = self.result(request["method"], message["result"])
        return message

    def result(self, method: str, result: Message) -> Message:
        return result

    def line(self, message: Message) -> bytes:
        return msgspec.json.encode(self.message(message)) + b"\n"

    def message(self, message: Message) -> Message:
        return message


def members(value: Any) -> Iterator[Message]:
    """Yield all objects inside a value."""
    if isinstance(value, dict):
        yield value
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from members(each)


class Members(Adapter):
    """Changes one member wherever it stands."""

    name: str = ""

    def change(self, value: Any) -> Any:
        raise NotImplementedError

    def message(self, message: Message) -> Message:
        for each in members(message):
            if self.name in each:
                each[self.name] = self.change(each[self.name])
        return message


class TextForVarId(Members):
    name, tells = "varId", "expected `int`, got `str`"
    change = staticmethod(str)


class OtherName(Adapter):
    tells = "BP-QueryNumberBufferedPayloads: the result has no member number"

    def result(self, method, result):
        return {("count" if name == "number" else name): value for name, value in result.items()}


class MillisecondsOfDay(Members):
    name, tells = "tStamp", "is a time in ms, not in ns since 1970"

    def change(self, value):
        return value // 10**6 if value > 10**17 else value


class WithoutColons(Members):
    name, tells = "prodId", "prodId is without colons"

    def change(self, value):
        return value.replace(":", "")


class NoVersion(Adapter):
    tells = 'no member "jsonrpc": "2.0"'

    def message(self, message):
        del message["jsonrpc"]
        return message


class UpperCase(Members):
    """No fault: hexadecimal digits may be in either case."""

    name = "value"

    def change(self, value):
        return value.upper() if isinstance(value, str) else value


class Seconds(Members):
    name, tells = "timeout", "for a variable that was created with"

    def change(self, value):
        return value // 1000


class NumbersForFlags(Members):
    name, tells = "isDeleted", "expected `bool`, got `int`"
    change = staticmethod(int)


class ObjectForList(Adapter):
    tells = "protocols: expected `array`, got `object`"

    def result(self, method, result):
        if "protocols" in result:
            result["protocols"] = {str(each["protocolId"]): each for each in result["protocols"]}
        return result


class Separators(Members):
    name, tells = "value", "value: expected `str` matching regex"

    def change(self, value):
        return "0x" + value if isinstance(value, str) else value


class BareStatus(Adapter):
    tells = "has not the form of a status"

    def result(self, method, result):
        if not method.startswith("UT-"):
            result["status"] = result["status"].rpartition("STATUS-")[2]
        return result


class LibraryError(Adapter):
    """A JSON-RPC library sends -32603 for each exception, also if the daemon cannot be reached."""

    tells = "error -32603 for an implementation that cannot be reached"

    def instead(self, request):
        if request["method"] not in ("RTDB-Read", "BP-QueryNumberBufferedPayloads"):
            return None
        error = {"code": -32603, "message": "ConnectionRefusedError: bp.sock Connection refused"}
        return {"jsonrpc": "2.0", "id": request["id"], "error": error}


class Lists(Adapter):
    tells = "UT-Hello lists it, but it is answered with -32601"

    def instead(self, request):
        if request["method"] != "BP-ClearBuffer":
            return None
        return {"jsonrpc": "2.0", "id": request["id"], "error": {"code": -32601, "message": "no such method"}}


class KeepsParameters(Adapter):
    tells = "it does not restore parameters: BPPAR_BEACON_PERIOD is 110"

    def __init__(self):
        self.period = None

    def answered(self, request, message):
        params = request.get("params", {})
        if request["method"] == "BP-SetParameter" and params["name"] == "BPPAR_BEACON_PERIOD":
            self.period = params["value"]
        if request["method"] == "BP-GetParameters" and self.period is not None:
            message["result"]["parameters"]["BPPAR_BEACON_PERIOD"] = self.period
        return message


class LosesVarDis(Adapter):
    tells = "it does not restore VarDis"
    gone = False

    def answered(self, request, message):
        if request["method"] == "BP-DeregisterProtocol" and request["params"]["protId"] == 2:
            self.gone = True
        if self.gone and "protocols" in message.get("result", {}):
            found = message["result"]["protocols"]
            message["result"]["protocols"] = [each for each in found if each["protocolId"] != 2]
        return message


class EarlyNotification(Adapter):
    tells = "the notification of RTDB-Create precedes its answer"

    def answered(self, request, message):
        self.ahead = request["method"] == "RTDB-Create" and "result" in message and request["params"]
        return message

    def line(self, message):
        octets = super().line(message)
        if self.ahead and "id" in message:
            told = {
                "event": "created",
                "varId": self.ahead["varId"],
                "prodId": "02:00:00:00:00:01",
                "seqno": 0,
                "value": self.ahead["value"],
            }
            early = {"jsonrpc": "2.0", "method": "UT-VariableChanged", "params": told}
            return msgspec.json.encode(early) + b"\n" + octets
        return octets

    ahead: Any = None


class BrokenNotification(Adapter):
    tells = "UT-VariableChanged: there is no member `prodId`"

    def message(self, message):
        if message.get("method") == "UT-VariableChanged":
            del message["params"]["prodId"]
        return message


WRONG = (
    TextForVarId,
    OtherName,
    MillisecondsOfDay,
    WithoutColons,
    NoVersion,
    Seconds,
    NumbersForFlags,
    ObjectForList,
    Separators,
    BareStatus,
    LibraryError,
    Lists,
    KeepsParameters,
    LosesVarDis,
    EarlyNotification,
    BrokenNotification,
)


class Clock:
    """The time of the node, for modules that wait for notifications or compare times of day."""

    def __init__(self) -> None:
        self.passed = 0.0

    def time_ns(self) -> int:
        return EPOCH

    def monotonic(self) -> float:
        return self.passed

    def sleep(self, seconds: float) -> None:
        self.passed += seconds


@pytest.fixture(autouse=True)
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (contract, examination):
        monkeypatch.setattr(module, "time", Clock())


class VirtualStream(StreamUpperTester):
    """Notifications have the time of the node."""

    now: Callable[[], int] = lambda _: 0

    def poll(self) -> list[Notification]:
        return [msgspec.structs.replace(each, time=self.now()) for each in super().poll()]


def examined(make: Callable[[], Adapter]) -> tuple[list[str], Runner]:
    """Return the reports of the examination of an adapter, and the runner of a node that is reached by it."""
    sut = InProcess(reference_config(codec_of(PROFILE)))
    adapter = make()
    upper = VirtualStream("adapter", lambda _: NodeChannel(sut, adapter), 5.0)
    upper.now = lambda: sut.now  # type: ignore[method-assign]
    reports: list[str] = []
    upper.faults.report = reports.append
    restart = sut.restart

    def again() -> None:
        restart()
        upper.reconnect()

    sut.restart = again  # type: ignore[method-assign]
    runner = Runner(Session(codec_of(PROFILE), sut.lower_tester(), upper, Pics()), sut)
    runner.prepare()
    runner.examine()
    return reports, runner


@pytest.mark.parametrize("make", WRONG, ids=lambda make: make.__name__)
def test_a_fault_of_an_adapter_is_reported_as_its_own_and_fails_no_requirement(make):
    reports, runner = examined(make)
    assert any(make.tells in each for each in reports), reports
    assert all(each.startswith("the adapter, not the implementation: ") for each in reports)
    assert all("UPPER-TESTER.md" in each for each in reports)
    kinds = len(reports)
    for case in ordered(known_cases()[name] for name in CASES):
        result = runner.run(case)
        assert result.verdict not in (Verdict.FAIL, Verdict.ERROR), (case.id, result.reason)
        assert "None" not in result.reason
    assert len(reports) == len(set(reports)) >= kinds
    assert [each for each in runner.notes if each in reports] == reports


@pytest.mark.parametrize("make", [Adapter, UpperCase])
def test_an_adapter_that_keeps_to_the_contract_is_not_reported(make):
    reports, runner = examined(make)
    assert reports == []
    for case in ordered(known_cases()[name] for name in CASES):
        result = runner.run(case)
        assert result.verdict in (Verdict.PASS, Verdict.INFO), (case.id, result.reason)


def test_the_examination_names_each_method_once():
    _, runner = examined(Adapter)
    upper, codec = runner.session.upper, codec_of(PROFILE)
    found = Examination(upper, codec.profile, whole=True).walk()
    assert len({each.method for each in found}) == len(found) >= len(upper.methods)
    assert {each.outcome for each in found if each.method in upper.methods} == {"right"}


#: Output of Python 3.11 after an exception at the import, and in a constructor.
AT_IMPORT = b"""Traceback (most recent call last):
  File "/opt/adapter.py", line 3, in <module>
    import mystack
ModuleNotFoundError: No module named 'mystack'
"""
IN_CONSTRUCTOR = b"""reading adapter.toml
Traceback (most recent call last):
  File "/opt/adapter.py", line 40, in <module>
    Adapter().serve()
    ^^^^^^^^^
  File "/opt/adapter.py", line 12, in __init__
    self.path = settings["socket"]
                ~~~~~~~~^^^^^^^^^^
KeyError: 'socket'
"""


@pytest.mark.parametrize(
    ("output", "told"),
    [
        (AT_IMPORT, "; its output: ModuleNotFoundError: No module named 'mystack' (/opt/adapter.py, line 3)"),
        (IN_CONSTRUCTOR, "; its output: reading adapter.toml | KeyError: 'socket' (/opt/adapter.py, line 12)"),
        (b"".join(AT_IMPORT.splitlines(keepends=True)[1:]), "No module named 'mystack' (/opt/adapter.py, line 3)"),
        (AT_IMPORT[: AT_IMPORT.index(b"Module")], "    import mystack"),
        (b"no such socket\n", "; its output: no such socket"),
    ],
)
def test_an_exception_of_an_adapter_in_python_is_one_line(output: bytes, told: str):
    lines = LastLines()
    lines.take(output)
    assert lines.shown().endswith(told)
    if b"Error" in output:
        assert "Traceback" not in lines.shown()
