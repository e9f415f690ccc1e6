"""``dcp-selftest dictionary``."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from dcp_codec.common.commandline import say

from .common import jobs_option, quiet_option, write_file


@click.command("dictionary", epilog="Exit status: 0 the dictionary is written; 2 wrong usage.")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.argument("mutants", nargs=-1)
@jobs_option
@quiet_option
def command(file: Path, mutants: tuple[str, ...], jobs: int | None, *, quiet: bool) -> int:
    """Run every case against the mutants, and write the failed cases to FILE: the fault dictionary of the diagnosis.

    MUTANTS are identifiers or globs of mutants; the other faults of an existing FILE keep their signatures.
    """
    from dcp_conformance.cli.display import progress_bar
    from dcp_conformance.diagnosis import Dictionary
    from dcp_conformance.diagnosis.dictionary import decode, encode

    from dcp_selftest.diagnosis.dictionary_making import Outcome, make
    from dcp_selftest.mutants import all_mutants
    from dcp_selftest.runner import chosen

    picked = chosen(mutants)
    kept = {fault.id: fault for fault in decode(file.read_bytes()).faults} if mutants and file.exists() else {}
    cut: list[str] = []
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("mutants", total=len(picked))

        def done(outcome: Outcome) -> None:
            progress.update(task, advance=1, description=outcome.fault.id)
            if not outcome.complete:
                cut.append(outcome.fault.id)

        found = make(picked, jobs=jobs, on_result=done)
    kept.update((fault.id, fault) for fault in found.faults)
    known = all_mutants()
    dictionary = Dictionary(
        tuple(
            msgspec.structs.replace(fault, what=known[name].what, requirements=known[name].requirements)
            for name, fault in kept.items()
            if name in known
        )
    )
    write_file(file, encode(dictionary))
    invisible = sum(not fault.fails for fault in dictionary.faults)
    say(f"{len(dictionary.faults)} faults, {invisible} without a failed case; {file}")
    for name in sorted(cut):
        say(f"{name}: not all cases were run, because they take too long")
    return 0
