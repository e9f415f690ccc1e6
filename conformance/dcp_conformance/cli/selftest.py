"""``dcp-conformance selftest``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import say
from dcp_conformance.errors import UsageError

if TYPE_CHECKING:
    from dcp_conformance.selftest.citations.campaign import CitationsResult
    from dcp_conformance.selftest.generated.campaign import GeneratedResult
    from dcp_conformance.selftest.mutants.mutant import Mutant
    from dcp_conformance.selftest.recordings import CleanResult, FaultyResult
    from dcp_conformance.selftest.runner import Baseline, SelftestResult, Trial
    from dcp_conformance.selftest.side_by_side import Comparisons
    from dcp_conformance.selftest.variants.campaign import Judged, VariantsResult
    from dcp_conformance.selftest.variants.variant import Variant

EXIT_STATUS = (
    "Exit status: 0 the reference node passes and every mutant is killed by a case that names its requirement; "
    "1 the node fails a case, or a mutant is not killed; 2 wrong usage; 4 a case ended in an error of the tester. "
    "With --variants, 0 means that no variant fails a case and that every inconclusive verdict is explained. "
    "With --citations, 0 means that every citation is proved by a case or test, or has a reason in the "
    "ledger that is still needed. With --recordings, 0 means no finding in networks without a fault."
)
#: Maximum number of selected mutants that are shown in separate rows without --verbose.
_FEW = 40


@click.command("selftest", epilog=EXIT_STATUS)
@click.argument("mutants", nargs=-1)
@click.option(
    "-p", "--profile", multiple=True, metavar="NAME", help="Use only this wire profile.  [default: all versions]"
)
@click.option("--full", is_flag=True, help="Run all cases against each mutant, not only those of its requirement.")
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    help="Number of concurrent processes.  [default: one for each processor]",
)
@click.option("--report-dir", type=click.Path(path_type=Path), metavar="DIR", help="Write selftest.json there.")
@click.option(
    "--document",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the table of this command into its section of FILE (Markdown).",
)
@click.option(
    "--generated",
    type=click.IntRange(1),
    metavar="N",
    help="Try N random changes of the node's source instead; MUTANTS are parts of their text or their keys.",
)
@click.option(
    "--seed",
    type=int,
    multiple=True,
    default=(1,),
    show_default=True,
    metavar="N",
    help="Random seed of --generated and --diagnose; may be given several times.",
)
@click.option(
    "--check-ledger",
    is_flag=True,
    help="With --generated, also try changes in the ledger, to find those that a case kills.",
)
@click.option(
    "--variants",
    is_flag=True,
    help="Try permitted variants of the node instead: none may fail. MUTANTS are identifiers of variants.",
)
@click.option(
    "--citations",
    is_flag=True,
    help="Check citations (##= ID) in the node's source instead: a case or test with the same ID must detect "
    "changes of the cited code. MUTANTS are IDs or file names.",
)
@click.option(
    "--side-by-side",
    is_flag=True,
    help="Compare the verdicts of concurrent cases with those of cases in succession, for the reference node and for "
    "mutants.",
)
@click.option(
    "--recordings",
    is_flag=True,
    help="Test 'check' instead: each mutant in a simulated network of five nodes, on a bus and in a line.",
)
@click.option(
    "--clean",
    type=click.IntRange(0),
    default=50,
    show_default=True,
    metavar="N",
    help="With --recordings, also judge N networks without a fault, which must have no finding.",
)
@click.option(
    "--dictionary",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Run every case against the mutants, and write the failed cases: the fault dictionary of the diagnosis.",
)
@click.option(
    "--diagnose",
    type=click.IntRange(1),
    metavar="N",
    help="Diagnose N nodes with two and N nodes with three faults at once, drawn with --seed.",
)
@click.option(
    "--smoke-plan",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Measure the duration of each case, and choose the cases of the smoke plan by the fault dictionary.",
)
@click.option("--list", "listing", is_flag=True, help="Only show the mutants or variants.")
@click.option("--verbose", "-v", is_flag=True, help="Show a line for every mutant.")
@click.option("--quiet", "-q", is_flag=True, help="Show only problems, and the numbers.")
def command(mutants: tuple[str, ...], **options: Any) -> int:
    """Test the suite: the reference node and its permitted variants must pass, and small faults must be detected.

    MUTANTS are identifiers of mutants or of the requirements that they violate, or globs of them; all by default.
    """
    if options["dictionary"] is not None or options["diagnose"] is not None:
        from .diagnosis import make_dictionary, measure_diagnosis

        return measure_diagnosis(options) if options["dictionary"] is None else make_dictionary(mutants, options)
    if options["smoke_plan"] is not None:
        from .smoke_plan import make_smoke_plan

        return make_smoke_plan(options)
    if options["side_by_side"]:
        return _side_by_side(mutants, options)
    if options["recordings"]:
        return _recordings(mutants, options)
    if options["citations"]:
        return _citations(mutants, options)
    if options["variants"]:
        return _variants(mutants, options)
    if options["generated"] is not None:
        return _generated(mutants, options)
    from dcp_conformance.selftest.runner import Trial, chosen, selftest

    from .display import progress_bar
    from .selftest_display import print_selftest

    picked = chosen(mutants)
    if options["listing"]:
        for each in picked:
            say(f"{each.id:<44}  {each.what}  [{', '.join(each.requirements)}; {_versions(each)}]")
        return 0
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("mutants", total=None)

        def done(outcome: Baseline | Trial) -> None:
            name = outcome.mutant if isinstance(outcome, Trial) else outcome.profile
            progress.update(task, advance=1, description=name)

        result = selftest(
            picked,
            profiles=options["profile"],
            full=options["full"],
            # The document needs all killers: the first one changes with the order of the cases.
            every=options["document"] is not None,
            jobs=options["jobs"],
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    _write(result, options["report_dir"], options["document"])
    print_selftest(
        result, verbose=options["verbose"] or (bool(mutants) and len(picked) <= _FEW), quiet=options["quiet"]
    )
    return result.exit_status()


def _side_by_side(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Compare the verdicts of concurrent cases and of cases in succession. Return the exit status."""
    from dcp_conformance.selftest.runner import chosen
    from dcp_conformance.selftest.side_by_side import Comparison, compare_all

    from .display import progress_bar

    _refuse(options, ("full", "document", "generated", "variants", "citations"), "--side-by-side")
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("mutants", total=None)

        def done(comparison: Comparison) -> None:
            progress.update(task, advance=1, description=f"{comparison.mutant} {comparison.profile}")

        result = compare_all(
            chosen(patterns),
            profiles=options["profile"],
            jobs=options["jobs"],
            seed=options["seed"][0],
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    if options["report_dir"] is not None:
        _write_json(result, options["report_dir"], "side-by-side.json")
    for each in result.comparisons:
        if each.survives or each.our_node or options["verbose"]:
            for difference in each.differences:
                say(str(difference))
    say(result.summary())
    return result.exit_status()


def _refuse(options: dict[str, Any], names: tuple[str, ...], mode: str) -> None:
    """Raise ``UsageError`` if an option does not apply to the selected mode of the command."""
    for name in names:
        if options[name]:
            raise UsageError(f"--{name.replace('_', '-')} does not go with {mode}")


def _recordings(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Check simulated recordings with and without a faulty node. Return the exit status."""
    from dcp_codec.common.atomic_write import write_whole
    from dcp_conformance.selftest.recordings import clean, faulty
    from dcp_conformance.selftest.recordings.table import document
    from dcp_conformance.selftest.runner import chosen

    from .display import progress_bar
    from .selftest_display import print_recordings

    for name in ("full", "generated", "variants", "citations", "profile"):
        if options[name]:
            raise UsageError(f"--{name} does not go with --recordings")
    picked = chosen(patterns)
    jobs = options["jobs"]
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("networks", total=2 * len(picked) + options["clean"])
        result = faulty(
            picked, jobs=jobs, on_result=lambda each: progress.update(task, advance=1, description=each.mutant)
        )
        networks = clean(
            range(options["clean"]),
            jobs=jobs,
            on_result=lambda number, _: progress.update(task, advance=1, description=f"network {number}"),
        )
    if options["report_dir"] is not None:
        _write_json(result, options["report_dir"], "recordings-faulty.json")
        _write_json(networks, options["report_dir"], "recordings-clean.json")
    if options["document"] is not None:
        try:
            write_whole(options["document"], document(result, networks).encode())
        except OSError as error:
            raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None
    print_recordings(result, networks, verbose=options["verbose"] or (bool(patterns) and len(picked) <= _FEW))
    return 1 if networks.false else 0


def _generated(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Run the cases against generated mutants. Return the exit status."""
    from dcp_conformance.selftest.generated.campaign import Trial as Generated
    from dcp_conformance.selftest.generated.campaign import draw, reach, run

    from .display import progress_bar
    from .selftest_display import print_generated

    _refuse(options, ("profile", "full"), "--generated, which tries every case on every version")
    draws = {seed: draw(options["generated"], seed, patterns=patterns) for seed in options["seed"]}
    if not all(draws.values()):
        raise UsageError(f"no change of the node's source contains {' or '.join(map(repr, patterns))}")
    if options["listing"]:
        for site in dict.fromkeys(site for chosen in draws.values() for site in chosen):
            say(f"{site.key}  {site}")
        return 0
    results: list[GeneratedResult] = []
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("changes", total=sum(map(len, draws.values())))

        def done(trial: Generated) -> None:
            progress.update(task, advance=1, description=f"{trial.outcome.fate} {trial.site.module}:{trial.site.line}")

        reached = reach(jobs=options["jobs"]) if len(draws) > 1 else None
        for seed, chosen in draws.items():
            results.append(
                run(
                    chosen,
                    seed=seed,
                    jobs=options["jobs"],
                    excused=options["check_ledger"],
                    reached=reached,
                    on_result=done,
                )
            )
    for result in results:
        if options["report_dir"] is not None:
            name = "generated.json" if len(results) == 1 else f"generated-{result.seed}.json"
            _write_json(result, options["report_dir"], name)
        print_generated(result, verbose=options["verbose"])
    if options["document"] is not None:
        from dcp_conformance.selftest.generated.table import section

        _write_section(options["document"], "generated", section(results))
    return 1 if any(result.survivors or result.misplaced for result in results) else 0


def _citations(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Check whether each citation of a requirement is proved. Return the exit status."""
    from dcp_conformance.selftest.citations.campaign import Verdict, chosen, run
    from dcp_conformance.selftest.citations.unit_tests import checkout

    from .display import progress_bar
    from .selftest_display import print_citations

    _refuse(options, ("profile", "full", "document", "generated", "variants"), "--citations")
    picked = chosen(patterns)
    if options["listing"]:
        for each in picked:
            say(f"{each.requirement:<10}  {each}  {each.function or '(module)'}")
        return 0
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("citations", total=len(picked))

        def done(verdict: Verdict) -> None:
            progress.update(task, advance=1, description=f"{verdict.citation.requirement} {verdict.proof}")

        result = run(picked, jobs=options["jobs"], root=checkout(), on_result=done)
    if options["report_dir"] is not None:
        _write_json(result, options["report_dir"], "citations.json")
    print_citations(result, verbose=options["verbose"], quiet=options["quiet"])
    return 1 if result.unproved or result.outdated else 0


def _versions(each: Mutant | Variant) -> str:
    """Return a text with the versions of the specification that a mutant or variant concerns."""
    return f"since {each.since}" if each.until is None else f"{each.since} to {each.until}"


def _variants(patterns: tuple[str, ...], options: dict[str, Any]) -> int:
    """Run the cases against permitted variants. Return the exit status."""
    from dcp_conformance.selftest.variants import chosen
    from dcp_conformance.selftest.variants.campaign import run

    from .display import progress_bar
    from .selftest_display import print_variants

    _refuse(options, ("full", "generated"), "--variants, which tries every case on every version")
    picked = chosen(patterns)
    if options["listing"]:
        for each in picked:
            say(f"{each.id:<36}  {each.what}  [{each.why}; {_versions(each)}]")
        return 0
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("variants", total=None)

        def done(judged: Judged) -> None:
            progress.update(task, advance=1, description=f"{judged.variant} {judged.profile}")

        result = run(
            picked,
            profiles=options["profile"],
            jobs=options["jobs"],
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    if not result.trials:
        raise UsageError("none of these variants exists on these profiles")
    if options["report_dir"] is not None:
        _write_json(result, options["report_dir"], "variants.json")
    if options["document"] is not None:
        from dcp_conformance.selftest.variants.table import section

        _write_section(options["document"], "variants", section(result))
    print_variants(result, verbose=options["verbose"], quiet=options["quiet"])
    return result.exit_status()


def _write(result: SelftestResult, directory: Path | None, document: Path | None) -> None:
    if directory is not None:
        _write_json(result, directory, "selftest.json")
    if document is not None:
        from dcp_conformance.selftest.kill_matrix import markdown

        _write_section(document, "mutants", markdown(result))


def _write_section(document: Path, name: str, text: str) -> None:
    """Replace one section of the document; the sections of other commands are unchanged."""
    from dcp_conformance.selftest.document import DocumentError, write_section

    try:
        write_section(document, name, text)
    except DocumentError as error:
        raise UsageError(f"{document}: {error}") from None
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None


def _write_json(
    result: SelftestResult
    | GeneratedResult
    | VariantsResult
    | CitationsResult
    | Comparisons
    | FaultyResult
    | CleanResult,
    directory: Path,
    name: str,
) -> None:
    import msgspec

    data = msgspec.json.format(msgspec.json.encode(result), indent=2)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(data + b"\n")
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None
