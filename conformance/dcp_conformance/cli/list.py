"""``dcp-conformance list``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click

from dcp_codec.common.commandline import say

from .options import selection_of, selection_options


@click.command("list", epilog="Exit status: 0 cases were shown; 2 wrong usage, or no case is selected.")
@selection_options
@click.option("--json", "as_json", is_flag=True, help="Print all data of the cases as JSON.")
@click.option("--requirements", "by_requirement", is_flag=True, help="List the deciding cases of each requirement.")
def command(**options: Any) -> int:
    """Show all test cases, or the selected ones.

    CASES are identifiers of cases or of requirements, or globs of them.
    """
    from dcp_spec.catalogue.requirements import requirements

    from dcp_conformance.definitions.case import all_cases
    from dcp_conformance.execution.selection import select

    selection = selection_of(options)
    # Show cases that take long, too, because none is executed.
    chosen = select(all_cases(), replace(selection, plan="long") if selection.plan == "full" else selection)
    if options["as_json"]:
        import json

        entries = [
            {
                "id": case.id,
                "purpose": case.purpose,
                "section": case.section,
                "kind": str(case.kind),
                "requirements": list(case.requirements),
                "stimulus": case.stimulus,
                "expectation": case.expect,
                "window": case.window,
                "since": str(case.needs.since),
                "until": None if case.needs.until is None else str(case.needs.until),
                "upperTester": list(case.needs.ut),
                "entities": list(case.needs.entities),
                "pics": list(case.needs.pics),
                "destructive": case.destructive,
                "robustness": case.robustness,
                "smoke": case.smoke,
                "long": case.long,
            }
            for case in chosen
        ]
        click.echo(json.dumps(entries, indent=2))
    elif options["by_requirement"]:
        for identifier, entry in requirements().items():
            deciding = [case.id for case in chosen if identifier in case.requirements]
            if deciding:
                say(f"{identifier}  {entry.statement}")
                for each in deciding:
                    say(f"    {each}")
    else:
        section = ""
        for case in chosen:
            if case.section != section:
                section = case.section
                click.echo("" if case is chosen[0] else "\n", nl=False)
                say(section)
            say(f"  {case.id:<28}  {case.purpose}  [{' '.join(case.requirements)}]")
    return 0
