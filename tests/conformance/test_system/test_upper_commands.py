"""Command lines as an upper tester, with small programs that print as tools do; and the built-in adapter."""

from __future__ import annotations

import stat
import time
from pathlib import Path

import pytest
from dcp_conformance.errors import UpperTesterError, UsageError
from dcp_conformance.upper_tester import open_upper
from dcp_conformance.upper_tester.commands_file import Method, Reading, converted, load_adapter, parameters_of_methods

from dcp_codec.common.processes import started_at

from ...waiting import PATIENCE

pytestmark = pytest.mark.part("links")

#: Seconds that what must come may take on a busy machine.
FILE = """
name = "fake tools"
version = "7"
spec_version = "1.3"
node_id = "02:00:00:00:00:01"
status = 'status (?P<status>\\w+)'
timeout = 20.0

[settings]
bin = "@BIN@/"

[statuses]
NO_SUCH_THING = "VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST"

[methods.RTDB-Create]
command = ["{bin}create", "{varId}", "{repCnt}", "{descr}", "{valueText}", "{timeout}"]
defaults = { timeout = "0" }

[methods.RTDB-Update]
command = ["{bin}update", "{varId}"]
stdin = "{value}"
exits = { 3 = "VARDIS-STATUS-NOT-PRODUCER" }
errors = { "out of range" = -32602 }

[methods.RTDB-Delete]
command = ["{bin}delete", "{varId}"]
success = "deleted"
ok = "VARDIS-STATUS-OK"

[methods.RTDB-Read]
command = ["{bin}read", "{varId}"]
result = { pattern = 'value=(?P<value>.*) at (?P<tStamp>.*)', types = { value = "octets", tStamp = "utc" } }

[methods.RTDB-DescribeDatabase]
command = ["{bin}list"]

[methods.RTDB-DescribeDatabase.rows]
member = "variables"
complete = true
pattern = '^(?P<varId>0x\\w+) (?P<prodId>\\S+) (?P<isDeleted>yes|no)(?: "(?P<descr>.*)")?$'
types = { varId = "hex", isDeleted = "bool" }

[methods.BP-RegisterProtocol]
command = ["{bin}register", "{protId}", "{name}", "{maxPayloadSize}"]
fixed = { queueingMode = "BP_QMODE_ONCE", maxEntries = "0", allowMultiplePayloads = "false" }
"""


@pytest.fixture
def tools(tmp_path):
    """Writes shell scripts, and opens an adapter for them."""

    def tool(name: str, script: str) -> None:
        path = tmp_path / name
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    for name in ("create", "update", "delete", "read", "list", "register"):
        tool(name, "exit 0")
    path = tmp_path / "tools.toml"
    path.write_text(FILE.replace("@BIN@", str(tmp_path)))
    tool.path = path  # type: ignore[attr-defined]
    tool.open = lambda settings="", **keys: open_upper(f"commands:{path}{settings}", **keys)  # type: ignore[attr-defined]
    return tool


def test_methods_of_an_adapter_file(tools):
    upper = tools.open()
    assert upper.methods == set(load_adapter(str(tools.path)).methods)
    assert upper.about == upper.call("UT-Hello", {}).result
    assert upper.about["nodeId"] == "02:00:00:00:00:01"
    assert (upper.about["name"], upper.about["version"], upper.about["specVersion"]) == ("fake tools", "7", "1.3")
    assert upper.call("UT-NoSuchMethod", {}).code == -32601
    assert upper.call("RTDB-Write", {}).code == -32601
    assert (upper.poll(), upper.filenos(), upper.another()) == ([], (), None)
    upper.reconnect()
    upper.close()


def test_parameters_are_inserted_into_commands(tools, tmp_path):
    tools("create", f'for each in "$@"; do printf "<%s>" "$each"; done > {tmp_path}/said')
    upper = tools.open()
    value = "a b; $(id) é"
    params = {"varId": 7, "repCnt": 2, "descr": 'it\'s "x"', "value": value.encode().hex()}
    answer = upper.call("RTDB-Create", params)
    # Exit status 0 is a success of the protocol.
    assert (answer.ok, answer.result) == (True, {"status": "VARDIS-STATUS-OK"})
    assert (tmp_path / "said").read_text() == f'<7><2><it\'s "x"><{value}><0>'
    upper.call("RTDB-Create", {**params, "timeout": 9})
    assert (tmp_path / "said").read_text().endswith("<9>")


def test_values_that_a_command_cannot_express(tools):
    upper = tools.open()
    create = {"varId": 7, "repCnt": 2, "descr": "x", "value": "ff"}
    with pytest.raises(UpperTesterError, match=r"RTDB-Create: the command takes value as text, which 'ff' is not"):
        upper.call("RTDB-Create", create)
    with pytest.raises(UpperTesterError, match="cannot hold the octet 0, which valueText has"):
        upper.call("RTDB-Create", {**create, "value": "00"})
    with pytest.raises(UpperTesterError, match="accepts prodId not at all, and not '02'"):
        upper.call("RTDB-Create", {**create, "value": "31", "prodId": "02"})
    with pytest.raises(UpperTesterError, match="the command needs descr, which was not given"):
        upper.call("RTDB-Create", {"varId": 7, "repCnt": 2, "value": "31"})
    register = {"protId": 5, "name": "x", "maxPayloadSize": 9, "queueingMode": "BP_QMODE_ONCE", "maxEntries": 0}
    assert upper.call("BP-RegisterProtocol", {**register, "allowMultiplePayloads": False}).status == "BP-STATUS-OK"
    with pytest.raises(UpperTesterError, match="queueingMode only with BP_QMODE_ONCE, and not 'BP_QMODE_REPEAT'"):
        upper.call("BP-RegisterProtocol", {**register, "queueingMode": "BP_QMODE_REPEAT"})


def test_outcomes_of_commands(tools):
    tools("update", 'read value; test "$value" = 55 && { echo "varid out of range" >&2; exit 1; }; exit $value')
    upper = tools.open()
    assert upper.call("RTDB-Update", {"varId": 1, "value": "0"}).ok
    assert upper.call("RTDB-Update", {"varId": 1, "value": "3"}).status == "VARDIS-STATUS-NOT-PRODUCER"
    refused = upper.call("RTDB-Update", {"varId": 1, "value": "55"})
    assert (refused.code, refused.message, refused.ok) == (-32602, "out of range", False)
    with pytest.raises(
        UpperTesterError, match=r"the command ended with exit status 9, and there is no status .* nothing"
    ):
        upper.call("RTDB-Update", {"varId": 1, "value": "9"})
    tools("delete", "echo deleted; exit 5")
    assert upper.call("RTDB-Delete", {"varId": 1}).ok
    tools("delete", "echo it failed with status NO_SUCH_THING")
    assert upper.call("RTDB-Delete", {"varId": 1}).status == "VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST"
    tools("delete", "echo status VARDIS_STATUS_INACTIVE >&2; exit 1")
    assert upper.call("RTDB-Delete", {"varId": 1}).status == "VARDIS_STATUS_INACTIVE"
    tools("delete", "echo status VARDIS_STATUS_ODD")
    odd = upper.call("RTDB-Delete", {"varId": 1})
    assert (odd.status, odd.known, odd.ok) == ("VARDIS_STATUS_ODD", False, False)
    tools("delete", "echo; exit 0")
    with pytest.raises(UpperTesterError, match="outcome cannot be understood"):
        upper.call("RTDB-Delete", {"varId": 1})


def test_results(tools):
    tools("read", "echo 'value={0a,FF} at 2026-01-31 12:00:00.000000007'")
    upper = tools.open()
    answer = upper.call("RTDB-Read", {"varId": 1})
    assert answer.result == {
        "status": "VARDIS-STATUS-OK",
        "value": "0aff",
        "tStamp": 1_769_860_800_000_000_007,
    }
    tools("read", "echo 'value=1 at noon'")
    with pytest.raises(UpperTesterError, match="value is '1'; expected octets"):
        upper.call("RTDB-Read", {"varId": 1})
    tools("read", "echo nonsense")
    with pytest.raises(UpperTesterError, match="not as the adapter file expects: nonsense"):
        upper.call("RTDB-Read", {"varId": 1})


def test_rows(tools):
    tools("list", "echo '0x0a 02:01 yes \"a \"quoted\" one\"'; echo '0xff 02:02 no'")
    upper = tools.open()
    assert upper.call("RTDB-DescribeDatabase", {}).result["variables"] == [
        {"varId": 10, "prodId": "02:01", "isDeleted": True, "descr": 'a "quoted" one'},
        {"varId": 255, "prodId": "02:02", "isDeleted": False},
    ]
    tools("list", "exit 0")
    assert upper.call("RTDB-DescribeDatabase", {}).result["variables"] == []
    tools("list", "echo 0x01 02:01 perhaps")
    with pytest.raises(UpperTesterError, match="not as the adapter file expects: 0x01 02:01 perhaps"):
        upper.call("RTDB-DescribeDatabase", {})


def runs(pid: int, deadline: float) -> bool:
    """Whether a process still runs at a time of the monotonic clock."""
    while (there := started_at(pid) is not None) and time.monotonic() < deadline:
        time.sleep(0.01)
    return there


def test_commands_that_hang_flood_or_die(tools, tmp_path):
    begun = time.monotonic()
    usual = tools.path.read_text()
    tools("list", f"sleep 600 & echo $! > {tmp_path}/pid; echo waiting; wait")
    for patience in (0.5, 2.0, 10.0, 50.0):
        tools.path.write_text(usual.replace("timeout = 20.0", f"timeout = {patience}"))
        upper = tools.open()
        with pytest.raises(UpperTesterError, match=rf"list did not end within {patience:g} s") as said:
            upper.call("RTDB-DescribeDatabase", {})
        # On a busy machine it may not even have begun.
        if str(said.value).endswith("Output: waiting"):
            break
    assert str(said.value).endswith("Output: waiting")
    assert not runs(int((tmp_path / "pid").read_text()), begun + PATIENCE)
    tools.path.write_text(usual.replace("timeout = 20.0", "timeout = 0.5"))
    tools("list", "while :; do echo 0123456789012345678901234567890123456789; done")
    with pytest.raises(UpperTesterError, match="did not end within"):
        tools.open().call("RTDB-DescribeDatabase", {})
    tools.path.write_text(usual.replace("timeout = 20.0", f"timeout = {PATIENCE}"))
    upper = tools.open()
    tools("list", "kill -SEGV $$")
    with pytest.raises(UpperTesterError, match="the command ended with signal SIGSEGV"):
        upper.call("RTDB-DescribeDatabase", {})
    # A process that stays in the background does not delay the call.
    tools("list", "sleep 600 & exit 0")
    assert upper.call("RTDB-DescribeDatabase", {}).ok
    (tmp_path / "list").unlink()
    with pytest.raises(UpperTesterError, match="list cannot be started: No such file"):
        upper.call("RTDB-DescribeDatabase", {})


def test_settings(tools, tmp_path):
    tools("delete", "echo deleted")
    with pytest.raises(UsageError, match=r"there is no program /elsewhere/create; settings: bin=/elsewhere/; name its"):
        tools.open(",bin=/elsewhere/")
    with pytest.raises(UsageError, match="the adapter has no setting 'bni'; there are: bin"):
        tools.open(",bni=x")
    assert tools.open(f",bin={tmp_path}/").call("RTDB-Delete", {"varId": 1}) is not None


BAD = {
    "no TOML": ("name = ", "Invalid value"),
    "unknown key": ('name = "x"\nmethod = {}\nmethods = {}', "unknown field `method`"),
    "wrong type": ('name = "x"\n[methods.RTDB-Read]\ncommand = "ls"', r"Expected `array`, got `str` .*RTDB-Read|array"),
    "no command": ('name = "x"\n[methods.RTDB-Read]\ncommand = []', "length >= 1"),
    "unknown method": ('name = "x"\n[methods.RTDB-Write]\ncommand = ["true"]', "methods.RTDB-Write: there is no such"),
    "unknown parameter": (
        'name = "x"\n[methods.RTDB-Read]\ncommand = ["true", "{varid}"]',
        "methods.RTDB-Read.command: {varid} is neither a parameter of the method nor a setting; there are: varId",
    ),
    "default of nothing": (
        'name = "x"\n[methods.RTDB-Read]\ncommand = ["true"]\ndefaults = { size = "1" }',
        "size: the method has no such parameter; there are: varId",
    ),
    "bad expression": ('name = "x"\n[methods.RTDB-Read]\ncommand = ["true"]\nsuccess = "("', "no regular expression"),
    "no group": ('name = "x"\nmethods = {}\nstatus = "x"', r"status: the expression has no group \(\?P<status>"),
    "unknown status": (
        'name = "x"\n[methods.RTDB-Read]\ncommand = ["true"]\nok = "FINE"',
        "the specification has no status 'FINE'",
    ),
    "type of nothing": (
        'name = "x"\n[methods.RTDB-Read]\ncommand = ["true"]\nresult = { pattern = "x", types = { value = "int" } }',
        "result.types.value: the pattern has no such group",
    ),
    "unknown type": (
        'name = "x"\n[methods.RTDB-Read]\ncommand = ["true"]\nresult = { pattern = "(?P<a>)", types = {a = "float"} }',
        "Invalid enum value 'float'",
    ),
    "rows of nothing": (
        'name = "x"\n[methods.RTDB-DescribeDatabase]\ncommand = ["true"]\nrows = { pattern = "x" }',
        "rows.member: which member",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_files(tmp_path, case):
    text, message = BAD[case]
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=message) as caught:
        open_upper(f"commands:{path}")
    assert str(caught.value).startswith(f"commands:{path}: ")


def test_values():
    assert converted("utc", "2026-01-31 12:00:00") == 1_769_860_800 * 10**9
    assert converted("utc", "2026-01-31 12:00:00.5") == 1_769_860_800 * 10**9 + 500_000_000
    assert converted("octets", "") == ""
    assert converted("octets", "0x01 0x02") == "0102"
    assert converted("text-octets", "hé") == "68c3a9"
    assert [converted("bool", each) for each in ("1", "no", "True")] == [True, False, True]
    with pytest.raises(ValueError, match="maybe"):
        converted("bool", "maybe")
    # From the schema of the contract.
    assert parameters_of_methods()["RTDB-Create"] == {
        *("varId", "repCnt", "descr", "value", "timeout", "prodId", "ownFields")
    }
    assert parameters_of_methods()["UT-Reset"] == frozenset()


LIST = """varId = 7, prodId = 02:00:00:00:00:09, repCnt = 1, creationTime = 2026-01-31 12:00:00.000000007, \
timeout = 10000, descr = a, descr = b, tStamp = 2026-01-31 12:00:01.000000000, isDeleted = 1"""
DESCRIBE = """Describing variable:
   varId        = 7
   prodId       = 02:00:00:00:00:09
   repCnt       = 1
   creationTime = 2026-01-31 12:00:00.000000007
   timeout      = 10000
   description  = of mine
   seqno        = 3
   tStamp       = 2026-01-31 12:00:01.000000000
   countUpdate  = 1
   countCreate  = 0
   countDelete  = 2
   isDeleted    = false
   value_length = {length}
   data         = {data}

"""
PROTOCOLS = """Query client protocols: 1 protocols currently registered:
Protocol Variable (x) Protocol 1.3 (protocolId = 2):
    maxPayloadSize                 = 600
    queueingMode                   = BP_QMODE_QUEUE_DROPHEAD
    timeStampRegistration          = 2026-01-31 12:00:00.000000007
    maxEntries                     = 2
    allowMultiplePayloads          = 0
    cntOutgoingPayloads            = 6
"""
VARIABLE = {
    "varId": 7,
    "prodId": "02:00:00:00:00:09",
    "repCnt": 1,
    "creationTime": 1_769_860_800_000_000_007,
    "timeout": 10_000,
    "tStamp": 1_769_860_801_000_000_000,
}


@pytest.fixture
def cpp(tools, tmp_path):
    """The built-in adapter on programs that print what those of the C++ implementation print."""

    def says(name: str, text: str, status: int = 0) -> None:
        (tmp_path / f"{name}.out").write_text(text)
        tools(name, f'echo "$0" "$@" > {tmp_path}/asked; cat {tmp_path}/{name}.out; exit {status}')

    for name in ("vardisapp-list-variables", "vardisapp-describe-variable", "vardisapp-delete-variable", "dcpmain-bp"):
        says(name, "")
    says("dcpmain-vardis", "DCP (Drone Coordination Protocol) -- Variable Dissemination Protocol 1.3\n")
    return says, open_upper(f"commands:cpp-tools,bin={tmp_path}/,vardis_config=v.cfg,bp_config=b.cfg")


def test_the_cpp_tools(cpp, tmp_path):
    says, upper = cpp
    asked = tmp_path / "asked"
    assert upper.about["version"] == "1.3"
    # A program that knows its version does not show that a daemon runs.
    assert "UT-Hello" not in upper.methods
    assert upper.call("UT-Hello", {}).result["version"] == "1.3"
    says("vardisapp-list-variables", LIST + "\n")
    (variable,) = upper.call("RTDB-DescribeDatabase", {}).result["variables"]
    assert variable == {**VARIABLE, "descr": "a, descr = b", "isDeleted": True}
    says("vardisapp-describe-variable", DESCRIBE.format(length=2, data="{0a,ff}"))
    variable = upper.call("RTDB-DescribeVariable", {"varId": 7}).result["variable"]
    counts = {"seqno": 3, "countUpdate": 1, "countCreate": 0, "countDelete": 2}
    known = {**VARIABLE, **counts, "descr": "of mine", "isDeleted": False}
    assert variable == {**known, "value": "0aff"}
    assert asked.read_text().endswith("--varid=7\n")
    says("vardisapp-describe-variable", DESCRIBE.format(length=0, data=""))
    assert upper.call("RTDB-DescribeVariable", {"varId": 7}).result["variable"] == {**known, "value": ""}
    # Of a longer value only the beginning is printed.
    says("vardisapp-describe-variable", DESCRIBE.format(length=33, data="{" + "00," * 31 + "00}"))
    assert upper.call("RTDB-DescribeVariable", {"varId": 7}).result["variable"] == known


def test_statuses_of_the_cpp_tools(cpp, tmp_path):
    says, upper = cpp
    failed = "failed with status VARDIS_STATUS_VARIABLE_DOES_NOT_EXIST. Exiting.\n"
    says("vardisapp-describe-variable", f"Describing variable 9 {failed}", 1)
    says("vardisapp-delete-variable", f"Deleting variable 9 {failed}", 1)
    for method in ("RTDB-DescribeVariable", "RTDB-Delete"):
        assert upper.call(method, {"varId": 9}).status == "VARDIS_STATUS_VARIABLE_DOES_NOT_EXIST"
    says("vardisapp-delete-variable", "Deleted variable 9 successfully. Exiting.\n")
    assert upper.call("RTDB-Delete", {"varId": 9}).ok
    says("vardisapp-delete-variable", "Varid outside allowed range. Aborting.\n", 1)
    assert upper.call("RTDB-Delete", {"varId": 300}).code == -32602
    shared_memory = (
        "DCP ERROR [ShmException](dcp-shm.attach_to_shm_area): cannot open shared memory region\n. Exiting.\n"
    )
    says("vardisapp-list-variables", shared_memory, 1)
    with pytest.raises(UpperTesterError, match="cannot open shared memory region"):
        upper.call("RTDB-DescribeDatabase", {})
    says("dcpmain-bp", "BP return status = BP_STATUS_OK\n")
    assert upper.call("BP-MGMT-Activate", {}).ok
    assert (tmp_path / "asked").read_text().endswith("--activate=b.cfg\n")
    says("dcpmain-bp", "")
    with pytest.raises(UpperTesterError, match="cannot be understood"):
        upper.call("BP-MGMT-Activate", {})
    says("dcpmain-vardis", "")
    assert upper.call("VD-MGMT-Deactivate", {}).status == "VARDIS-STATUS-OK"
    says("dcpmain-vardis", "Management command failed with status code VARDIS_STATUS_INACTIVE\n", 1)
    assert upper.call("VD-MGMT-Deactivate", {}).status == "VARDIS_STATUS_INACTIVE"
    says("dcpmain-bp", PROTOCOLS)
    assert upper.call("BP-ListRegisteredProtocols", {}).result["protocols"] == [
        {
            "protocolName": "Variable (x) Protocol 1.3",
            "protocolId": 2,
            "maxPayloadSize": 600,
            "queueMode": "BP_QMODE_QUEUE_DROPHEAD",
            "timeStampRegistration": 1_769_860_800_000_000_007,
            "maxEntries": 2,
            "allowMultiplePayloads": False,
        }
    ]
    says("dcpmain-bp", "Query client protocols: No client protocols registered.\n")
    assert upper.call("BP-ListRegisteredProtocols", {}).result["protocols"] == []


def test_the_example_in_the_documentation(tmp_path):
    text = (Path(__file__).resolve().parents[3] / "docs" / "upper-tester-commands.md").read_text()
    example = text.partition("## File format")[2].partition("```toml\n")[2].partition("```")[0]
    path = tmp_path / "example.toml"
    path.write_text(example)
    adapter = load_adapter(str(path))
    assert set(adapter.methods) == {"RTDB-Create", "RTDB-Update", "RTDB-Read", "RTDB-DescribeDatabase"}
    for kind in Method.__struct_fields__:
        assert f"`{kind}`" in text
    for kind in Reading.__struct_fields__:
        assert f"`{kind}`" in text


def test_a_file_does_not_replace_a_built_in_adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cpp-tools").write_text('name = "evil"\n[methods]\n')
    assert load_adapter("cpp-tools").name != "evil"


def test_an_adapter_writable_by_other_users_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n[methods]\n')
    assert load_adapter(str(path)).name == "mine"
    path.chmod(0o666)
    with pytest.raises(UsageError, match="can be changed by every user"):
        load_adapter(str(path))
