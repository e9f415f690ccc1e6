"""``dcp-conformance selftest``: the fault dictionary and the accuracy of the diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from dcp_codec.common.commandline import say
from dcp_conformance.errors import UsageError

#: Required minimum share of named faults, and maximum share of false faults among the named ones.
_RECALL, _FALSE = 0.9, 0.1
#: Number of single faults that are held back, for each pair.
_HELD_BACK = 4


def make_dictionary(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Run every case against the mutants, and write the fault dictionary. Return the exit status.

    With patterns, the other faults of an existing dictionary keep their signatures. Raise ``UsageError`` if the file
    cannot be written.
    """
    from dcp_conformance.diagnosis import Dictionary
    from dcp_conformance.diagnosis.dictionary import decode, encode
    from dcp_conformance.selftest.diagnosis.dictionary_making import Outcome, make
    from dcp_conformance.selftest.mutants import all_mutants
    from dcp_conformance.selftest.runner import chosen

    from .display import progress_bar

    file: Path = options["dictionary"]
    picked = chosen(patterns)
    kept = {fault.id: fault for fault in decode(file.read_bytes()).faults} if patterns and file.exists() else {}
    cut: list[str] = []
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("mutants", total=len(picked))

        def done(outcome: Outcome) -> None:
            progress.update(task, advance=1, description=outcome.fault.id)
            if not outcome.complete:
                cut.append(outcome.fault.id)

        found = make(picked, jobs=options["jobs"], on_result=done)
    kept.update((fault.id, fault) for fault in found.faults)
    known = all_mutants()
    dictionary = Dictionary(
        tuple(
            msgspec.structs.replace(fault, what=known[name].what, requirements=known[name].requirements)
            for name, fault in kept.items()
            if name in known
        )
    )
    try:
        file.write_bytes(encode(dictionary))
    except OSError as error:
        raise UsageError(f"{file}: cannot be written: {error.strerror or error}") from None
    invisible = sum(not fault.fails for fault in dictionary.faults)
    say(f"{len(dictionary.faults)} faults, {invisible} without a failed case; {file}")
    for name in sorted(cut):
        say(f"{name}: not all cases were run, because they take too long")
    return 0


def measure_diagnosis(options: dict[str, Any]) -> int:
    """Diagnose nodes with several faults and print how many faults are identified. Return the exit status."""
    from dcp_conformance.diagnosis import load
    from dcp_conformance.selftest.diagnosis.measuring import Outcome, draw, hold_back, measure

    from .display import progress_bar

    number, good = options["diagnose"], True
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("nodes", total=2 * number)

        def done(outcome: Outcome) -> None:
            progress.update(task, advance=1, description=" + ".join(outcome.faults))

        for size, name in ((2, "pairs"), (3, "triples")):
            found = measure(draw(number, size, options["seed"][0]), jobs=options["jobs"], on_result=done)
            hidden = sum(len(each.hidden) for each in found.outcomes)
            say(
                f"{len(found.outcomes)} {name} of faults: {found.recall:.1%} of the faults are named, "
                f"{found.false_share:.1%} of the named ones are false ({hidden} faults are hidden by others)"
            )
            good = good and found.recall >= _RECALL and found.false_share < _FALSE
            for each in found.outcomes if options["verbose"] else ():
                missed = [fault for fault in each.faults if fault not in (*each.found, *each.hidden)]
                if missed or each.false:
                    say(f"  {' + '.join(each.faults)}: missed {missed}, false {list(each.false)}")
    held = hold_back(number * _HELD_BACK, options["seed"][0], load())
    say(
        f"{held.faults} single faults, each removed from the dictionary: {held.same} are explained by another fault of "
        f"the same requirement, {held.other} by faults of other requirements, {held.none} not at all; of "
        f'{held.statements} sentences without "probably" {held.true} name the requirement'
    )
    return 0 if good else 1
