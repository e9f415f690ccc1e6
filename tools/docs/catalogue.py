"""Generate the pages of requirements and of readings and hazards from the catalogue of ``dcp_spec``."""

from __future__ import annotations

from pathlib import Path

from dcp_selftest.traceability import Row, matrix
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import requirements

from .markdown import code, page

_PROTOCOLS = {
    "DATA": "Data types",
    "UWB": "Underlying wireless bearer",
    "BP": "Beaconing Protocol (BP)",
    "SRP": "State Reporting Protocol (SRP)",
    "VD": "Variable Dissemination Protocol (VarDis)",
}


def requirements_page(root: Path) -> str:
    """Return the page of all requirements, with the cases and rules that decide them. ``root``: the repository."""
    rows = {row.requirement.id: row for row in matrix(root).rows}
    parts = [
        f"{len(rows)} requirements. A *case* decides a requirement in a test run (`dcp-conformance run ID`), a *rule* "
        "judges it in recordings (`dcp-conformance check`).",
    ]
    for protocol, title in _PROTOCOLS.items():
        parts.append(f"## {title}")
        parts += [_requirement(rows[each.id]) for each in requirements().values() if each.protocol == protocol]
    return page("Requirements", *parts)


def _requirement(row: Row) -> str:
    it = row.requirement
    versions = f"since {it.since}" + (f", until {it.until}" if it.until else "")
    if it.not_in:
        versions += f", not in {', '.join(it.not_in)}"
    facts = [f"{it.level}", versions, f"observable: {', '.join(it.observable)}", f"`{it.section}`"]
    if it.step:
        facts.append(f"step {it.step}")
    lines = [f"### {it.id}", code(it.statement), "*" + "; ".join(facts) + "*"]
    decided = [f"Cases: {', '.join(f'`{name}`' for name in row.cases)}." if row.cases else f"No case: {row.why}"]
    if row.rules:
        decided.append(f"Rules: {', '.join(f'`{name}`' for name in row.rules)}.")
    if it.readings:
        decided.append("Readings: " + ", ".join(f"[{name}](readings.md#{name.lower()})" for name in it.readings) + ".")
    return "\n\n".join([*lines, " ".join(decided)])


def readings_page() -> str:
    """Return the page of all readings (X..) and hazards (H..)."""
    users: dict[str, list[str]] = {}
    for each in requirements().values():
        for name in each.readings:
            users.setdefault(name, []).append(each.id)
    parts = [
        "A *reading* (X..) is a way to read text of the specification that is contradictory or incomplete. A *hazard* "
        "(H..) is a consequence of the text that the users of a formation should know; no implementation fails "
        "because of it."
    ]
    for kind, title in (("contradiction", "Readings"), ("hazard", "Hazards")):
        parts.append(f"## {title}")
        for it in readings().values():
            if it.kind != kind:
                continue
            lines = [f"### {it.id}", f"**{it.title}**", code(it.problem), f"*Our reading.* {code(it.reading)}"]
            lines.append(f"*Reason.* {code(it.why)}")
            if it.implementations:
                lines.append(f"*Implementations.* {code(it.implementations)}")
            lines.append("\n".join(f"* `{each.name}`: {code(each.description)}" for each in it.alternatives))
            if it.kind == "hazard":
                until = f"{it.since} to {it.until}" if it.until else f"since {it.since}"
                lines.append(f"*Versions:* {until}")
            lines.append(f"*Sections:* {', '.join(f'`{each}`' for each in it.sections)}")
            if it.id in users:
                ids = ", ".join(f"[{name}](requirements.md#{name.lower()})" for name in users[it.id])
                lines.append(f"*Requirements:* {ids}")
            parts.append("\n\n".join(line for line in lines if line))
    return page("Readings and hazards", *parts)
