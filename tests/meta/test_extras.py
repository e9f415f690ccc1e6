"""Installations without extras: which commands work, and messages about missing extras.

The processes below import the standard library, this project and the distributions of the chosen extras; everything
else fails to import as if it were not installed.
"""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from dcp_codec.common.extras import REQUIREMENTS, advice

from ..ports import own_port

pytestmark = pytest.mark.part("tools")

ROOT = Path(__file__).resolve().parents[2]
RECORDING = ROOT / "captures" / "b_crud.mcap"
#: Distributions of this project by name -> the project table of their file.
PROJECTS = {
    project["name"]: project
    for folder in (".", "lab", "tables")
    for project in [tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]]
}
OURS = {
    "dcp-conformance-kit": {"dcp_spec", "dcp_codec", "dcp_stack", "dcp_conformance"},
    "dcp-conformance-lab": {"dcp_lab"},
    "dcp-conformance-tables": {"dcp_tables"},
}
#: Runs a command of ours in a process where only the given packages of others can be imported.
PROGRAM = """
import importlib, importlib.abc, json, sys
package, allowed, arguments = json.loads(sys.argv[1])
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in allowed or top in sys.stdlib_module_names:
            return None
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
for name in list(sys.modules):
    if name.partition(".")[0] not in {*allowed, *sys.stdlib_module_names, "__main__"}:
        del sys.modules[name]
sys.meta_path.insert(0, Absent())
importlib.import_module(package).main(arguments)
"""


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def requirement(text: str) -> tuple[str, set[str]]:
    """Name and extras of a requirement; without those that only other systems or further extras need."""
    name, extras = re.match(r"([\w.-]+)(?:\[([^\]]*)\])?", text).groups()
    return normal(name), {each.strip() for each in (extras or "").split(",") if each.strip()}


def required(text: str) -> Iterator[str]:
    """All direct requirements of one of our distributions, from its file: the installed metadata may be old."""
    name, extras = requirement(text)
    if name not in PROJECTS:
        yield name
        return
    project = PROJECTS[name]
    for part in (project["dependencies"], *(project["optional-dependencies"][extra] for extra in extras)):
        for each in part:
            yield from required(each)
    yield name


provided = cache(importlib.metadata.packages_distributions)


@cache
def packages(*requirements: str) -> frozenset[str]:
    """Top-level packages that an installation of the kit and these requirements has, our own included."""
    todo = [name for each in ("dcp-conformance-kit", *requirements) for name in required(each)]
    found, tops = set[str](), set[str]()
    while todo:
        name = todo.pop()
        if name in found:
            continue
        found.add(name)
        tops |= OURS.get(name, set())
        try:
            texts = [] if name in OURS else importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # for another system, or another version of Python
        todo += [requirement(text)[0] for text in texts if "extra ==" not in text]
    found -= OURS.keys()
    return frozenset(tops | {top for top, names in provided().items() if found & {normal(name) for name in names}})


@dataclass(frozen=True)
class Done:
    status: int
    out: str
    err: str


KIT, LAB, TABLES = PROJECTS


def run(line: str, *requirements: str) -> Done:
    """Run a command as it behaves in an installation of the kit and these requirements."""
    name, *arguments = line.split()
    package = {"dcp-node": "dcp_stack", "dcp-codec": "dcp_codec", "dcp-conformance": "dcp_conformance"}[name] + ".cli"
    given = json.dumps([package, sorted(packages(*requirements)), arguments])
    done = subprocess.run([sys.executable, "-c", PROGRAM, given], capture_output=True, text=True, check=False)
    return Done(done.returncode, done.stdout, done.stderr)


def test_the_table_of_requirements_agrees_with_the_project_files():
    for package, requirement in REQUIREMENTS.items():
        assert package in packages(requirement), (package, requirement)
        assert package not in packages(), package


def test_the_help_of_all_commands_needs_no_extra():
    for line in ("dcp-node --help", "dcp-codec --help", "dcp-conformance --help", "dcp-node run --help"):
        assert run(line).status == 0, line


def test_a_node_over_udp_needs_no_extra(tmp_path):
    # The end of standard input is the end of the node.
    control = f"--link udp:239.255.77.1:{own_port()} --node-id 02:00:00:00:00:01 --control stdio"
    done = run(f"dcp-node run {control} --log-level error")
    assert (done.status, done.err) == (0, "")


def test_simulation_needs_only_the_laboratory():
    assert run("dcp-node simulate -n 2 --duration 2", LAB).status == 0


def test_pcap_needs_no_extra(tmp_path):
    medium = tmp_path / "medium.pcap"
    assert run(f"dcp-codec convert {RECORDING} {medium}", f"{KIT}[mcap]").status == 0
    done = run(f"dcp-codec stats {medium}")
    assert (done.status, "beacons in" in done.out) == (0, True)


def test_c_and_vectors_need_no_further_extra(tmp_path):
    assert run(f"dcp-codec export c --adapter --profile dcp-2.0 --out {tmp_path}").status == 0
    assert run(f"dcp-codec export rust --profile dcp-2.0 -o {tmp_path}/dcp_codec.rs").status == 0
    done = run(f"dcp-conformance vectors {tmp_path}/vectors --profile dcp-1.0", f"{KIT}[conformance]")
    assert (done.status, done.err) == (0, "")


@pytest.mark.parametrize(
    ("line", "package"),
    [
        (f"dcp-codec stats {RECORDING}", "mcap"),
        ("dcp-node run --link udp --control none --record {tmp}/node.mcap", "mcap"),
        ("dcp-codec export ksy --profile dcp-2.0", "yaml"),
        ("dcp-codec export scapy --profile dcp-2.0", "scapy"),
        (f"dcp-codec convert {RECORDING} {{tmp}}/ros.mcap --to ros2", "mcap"),
        (f"dcp-codec table {RECORDING} --out {{tmp}}/tables", "dcp_tables"),
        ("dcp-codec record --interface lo --out {tmp}/lo.pcap", "scapy"),
        ("dcp-node run --interface lo --node-id 02:00:00:00:00:01 --control none", "scapy"),
        ("dcp-node simulate -n 2 --duration 2", "dcp_lab"),
        ("dcp-conformance run --in-process TC_BP_TX_TI_04", "greenlet"),
        ("dcp-conformance fuzz live --interface lo", "dcp_lab"),
    ],
)
def test_a_missing_package_is_named_with_what_installs_it(line, package, tmp_path):
    done = run(line.format(tmp=tmp_path))
    assert done.status == 2
    assert done.err.strip().endswith(advice(package))
    assert "Traceback" not in done.err


def test_a_scenario_as_topology_needs_the_laboratory(tmp_path):
    line = f"dcp-conformance check {RECORDING} --topology {ROOT}/examples/line.toml --report-dir {tmp_path}/report"
    done = run(line, f"{KIT}[conformance]")
    assert (done.status, done.err.strip().endswith(advice("dcp_lab"))) == (2, True), done.err


def test_advice_names_the_index_and_the_clone():
    assert advice("dcp_lab") == (
        "dcp_lab is not installed: pip install 'dcp-conformance-lab', in a clone of the kit pip install './lab'"
    )
    assert advice("bokeh").endswith("in a clone of the kit pip install './tables[report]'")


CASES = "TC_BP_TX_TI_04 --jobs 1"


def test_a_run_in_process_needs_no_scapy(tmp_path):
    done = run(f"dcp-conformance run --in-process {CASES} --report-dir {tmp_path}/report", f"{KIT}[conformance]")
    assert done.status == 0, done.err
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_run_over_ethernet_reports_missing_scapy(tmp_path):
    done = run(f"dcp-conformance run --interface lo {CASES} --report-dir {tmp_path}/report", f"{KIT}[conformance]")
    assert advice("scapy") in done.err
    assert done.status == 4
    assert "Traceback" not in done.err


def test_only_one_package_imports_scapy():
    found = set[str]()
    for folder in (
        "spec/dcp_spec",
        "dcp_codec",
        "dcp_stack",
        "conformance/dcp_conformance",
        "lab/dcp_lab",
        "tables/dcp_tables",
    ):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if "scapy" in text else ():
                names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.level == 0:
                    names.append(node.module or "")
                if any(name.partition(".")[0] == "scapy" for name in names):
                    found.add(path.parent.relative_to(ROOT).as_posix())
    assert found == {"dcp_codec/scapy"}
