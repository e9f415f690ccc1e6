"""Render ``report.html``: one self-contained page that loads nothing from the network."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import requirements

from dcp_codec.codec import Codec
from dcp_codec.common import pages
from dcp_conformance.check.wording import moment
from dcp_conformance.definitions.pics_file import QUESTIONS
from dcp_conformance.definitions.results import CaseResult, Check, Mark, RunResult, summarise
from dcp_conformance.definitions.verdict import Verdict

from .frames import Frames
from .glossary import terms, terms_of
from .overview import certainty, deaths, diagnosed, headline, observed_readings, sentence
from .recordings import FOLDER
from .references import requirement_links, section_link
from .timeline import MOST_FRAMES, begin_of, collapse_repeats, timeline_of
from .to_declare import keys_of, to_declare

#: Number of findings that are expanded when the page opens.
_OPEN = 10
_ORDER = (
    Verdict.FAIL,
    Verdict.ERROR,
    Verdict.INCONCLUSIVE,
    Verdict.PASS,
    Verdict.INFO,
    Verdict.TOO_LITTLE,
    Verdict.NOT_APPLICABLE,
)


#: Names of recordings that the page links to. Results are untrusted: they must not make the page link elsewhere.
_RECORDING = re.compile(rf"{FOLDER}/[A-Za-z0-9_+=-][A-Za-z0-9._+=-]*")


def render(run: RunResult, codec: Codec | None) -> str:
    """Return the HTML page of one run. Without a codec, frames are shown as octets only."""
    apart = Frames(codec)
    known = requirements()
    cases = [_case(case, number, apart) for number, case in enumerate(run.cases)]
    by_result = {id(result): case for result, case in zip(run.cases, cases, strict=True)}
    alike = [{"how": death.how, "cases": [by_result[id(each)] for each in death.cases]} for death in deaths(run)]
    for case in cases:
        in_group = any(case is each for group in alike for each in group["cases"])
        case["shown_above"] = case["verdict"] in ("fail", "error") and not in_group
    summary = summarise(run.cases)
    return page(
        "report.html",
        run=run,
        title=" ".join(filter(None, (run.sut.name, run.sut.version))) or "An implementation of DCP",
        headline=headline(run),
        diagnosed=diagnosed(run),
        certainty=certainty,
        sentence=sentence,
        keys={case["id"]: ("f-" if case["shown_above"] else "") + case["key"] for case in cases},
        summary=summary,
        number=sum(case.counted for case in run.cases),
        tables=[table for table in ("conformance", "robustness") if any(summary[table].values())],
        order=[str(verdict) for verdict in _ORDER],
        counts_of={table: _tiles(summary[table]) for table in summary},
        sections=_sections(run),
        open_findings=_OPEN,
        deaths=alike,
        findings=[case for case in cases if case["shown_above"]],
        cases=cases,
        matrix=list(_matrix(run, cases)),
        failing=_failing(cases),
        to_declare=to_declare(run.cases),
        places=requirement_links(str(run.spec_version)),
        section_link=section_link,
        readings_known=readings(),
        requirement_counts=_counts(run),
        readings=list(observed_readings(run)),
        known=known,
        holdings=msgspec.json.encode(run.holdings).decode() if run.holdings.get("changes") else "",
        patience=run.holdings.get("patience_ns", 0) / 1e9,
        stale=[check for case in run.cases if case.id == "CK_NET_AGREES" for check in case.checks if check.frames],
        moment=moment,
        links=_links(run),
    )


def page(template: str, **values: Any) -> str:
    """Return the page of a template of this package."""
    own = pages.text(__package__, "page.js")
    return pages.render(__package__, template, own, glossary=terms(), terms_of=terms_of, **values)


def _tiles(counts: Mapping[str, int]) -> list[tuple[int, str, str]]:
    """Return number, name and kind of the verdicts that occur."""
    return [(counts[each], each.replace("-", " "), each) for each in map(str, _ORDER) if counts[each]]


def _links(run: RunResult) -> dict[str, Any] | None:
    """Return the nodes, and the link of each pair (listener, speaker); None if no link was inferred."""
    if not run.links:
        return None
    nodes = sorted({node for each in run.links for node in (each.listener, each.speaker)})
    return {"nodes": nodes, "of": {(each.listener, each.speaker): each for each in run.links}}


def _counts(run: RunResult) -> dict[str, int]:
    """Return the number of requirements with each verdict that occurs."""
    counts = Counter(run.requirements.values())
    return {str(verdict): counts[verdict] for verdict in _ORDER if counts[verdict]}


def _sections(run: RunResult) -> list[dict[str, Any]]:
    """Return the numbers of verdicts in each section of each table (conformance, robustness)."""
    found: dict[tuple[str, str], dict[str, int]] = {}
    for case in run.cases:
        if not case.counted:
            continue
        counts = found.setdefault((case.table, case.section), {str(verdict): 0 for verdict in _ORDER})
        counts[str(case.verdict)] += 1
    return [
        {"table": table, "name": section, "counts": counts, "total": sum(counts.values())}
        for (table, section), counts in sorted(found.items())
    ]


def _matrix(run: RunResult, cases: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each requirement that a case or a check names, in the order of the catalogue."""
    named = [
        {*case["requirements"], *(each for check in case["checks"] for each in check["requirements"])} for case in cases
    ]
    for identifier, entry in requirements().items():
        deciding = [case for case, names in zip(cases, named, strict=True) if identifier in names]
        if deciding:
            verdict = run.requirements.get(identifier)
            yield {
                "id": identifier,
                "statement": entry.statement,
                "verdict": str(verdict) if verdict is not None else "inconclusive",
                "cases": deciding,
            }


def _failing(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the requirements that fail and the cases in which they fail; the one with the most cases first."""
    found: dict[str, list[dict[str, Any]]] = {}
    for case in cases:
        failed = [check["requirements"] for check in case["checks"] if check["verdict"] == "fail"]
        for identifier in dict.fromkeys(each for names in failed for each in names):
            found.setdefault(identifier, []).append(case)
    known = requirements()
    rows = sorted(found.items(), key=lambda row: -len(row[1]))
    return [{"id": name, "entry": known[name], "cases": deciding} for name, deciding in rows if name in known]


def _case(case: CaseResult, number: int, apart: Frames) -> dict[str, Any]:
    """Return a case for the template; ``number`` makes its anchor."""
    return {
        **msgspec.structs.asdict(case),
        "key": f"c{number}",
        "id": case.id if case.attempt == 1 else f"{case.id} (attempt {case.attempt})",
        "verdict": str(case.verdict),
        "kind": {"BV": "valid", "BI": "invalid", "BO": "inopportune", "TI": "timer"}.get(case.kind, case.kind),
        "explained": any(check.verdict is case.verdict and check.observed for check in case.checks),
        "checks": _checks(case, apart),
        "to_declare": [(key, QUESTIONS[key]) for key in keys_of(case)],
        "timeline": collapse_repeats(list(timeline_of(case, apart)), case),
        "linked": _RECORDING.fullmatch(case.recording) is not None,
        "search": f"{case.id} {case.purpose} {' '.join(case.requirements)} {case.section}".lower(),
    }


def _checks(case: CaseResult, apart: Frames) -> list[dict[str, Any]]:
    """Return the checks of a case for the template.

    A frame is dissected at the first check that cites it, with the marks of all checks that cite it.
    """
    events = {event.frame: event for event in case.evidence if event.frame}
    marks: dict[int, list[Mark]] = {}
    for check in filter(_notable, case.checks):
        for mark in check.frames:
            marks.setdefault(mark.frame, []).append(mark)
    shown: set[int] = set()
    found = []
    for check in case.checks:
        notable = _notable(check)
        cited = list(dict.fromkeys(mark.frame for mark in check.frames))
        here = [number for number in cited if number in events][:MOST_FRAMES] if notable else []
        new = [number for number in here if number not in shown]
        shown.update(new)
        found.append(
            {
                **msgspec.structs.asdict(check),
                "verdict": str(check.verdict),
                "moment": "" if check.seconds is None else moment(check.seconds),
                "frames": [apart.frame(events[number], marks[number], begin_of(case)) for number in new],
                "again": [number for number in here if number not in new],
                "more": len(cited) - len(here) if notable else 0,
            }
        )
    return found


def _notable(check: Check) -> bool:
    """Return whether the page shows the frames of a check: it did not pass, or reports a behaviour with frames."""
    return check.verdict.rank > Verdict.PASS.rank or (check.verdict is Verdict.INFO and bool(check.frames))
