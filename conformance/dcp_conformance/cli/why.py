"""``dcp-conformance why``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import ETHER_TYPE_HELP, PROFILE_HELP, say
from dcp_conformance.errors import UsageError

from .links import link_options, links_of


@click.command("why", epilog="Exit status: 0 answered; 2 wrong usage, or nothing is known about the node or variable.")
@click.argument("capture", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--variable", type=int, required=True, metavar="ID", help="The variable.")
@click.option("--node", required=True, metavar="ID", help="The node; the end of its identifier is enough, as in 00:05.")
@click.option("--at", "seconds", type=float, metavar="S", help="Seconds since the first frame.  [default: the end]")
@link_options
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: detected]")
@click.option("--ether-type", metavar="HEX", help=ETHER_TYPE_HELP)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(
    capture: Path,
    variable: int,
    node: str,
    seconds: float | None,
    hears: tuple[str, ...],
    topology: Path | None,
    profile: str | None,
    ether_type: str | None,
    *,
    as_json: bool,
) -> int:
    """Tell why a node holds the value of a variable that it holds at a time.

    The answer is the chain of frames by which the value came to the node. If the producer has a newer one, it also
    tells what each node on the way has done with it. It is what the node's beacons state; what it has received is
    certain only where the answer names a proof.
    """
    import msgspec

    from dcp_conformance.check.recording import judges_of
    from dcp_conformance.check.why import why
    from dcp_conformance.definitions.pics import Pics

    _, judges, notes = judges_of(
        capture, profile, Pics(), ether_type=ether_type, show_progress=True,
        topology=links_of(hears, topology), all_rules=False,
    )  # fmt: skip
    for each in notes:
        say(f"{capture}: {each}", err=True)
    failure: UsageError | None = None
    for judge in judges:
        judge.result()
        try:
            answer = why(judge, variable, node, seconds)
        except UsageError as error:
            # A recording of two versions has the node in one of them.
            failure = error
            continue
        if as_json:
            say(msgspec.json.encode(answer).decode())
            return 0
        _print(answer)
        return 0
    assert failure is not None
    raise failure


def _print(answer: object) -> None:
    """Print an answer, with a line for each step."""
    from dcp_conformance.check.why import Answer, Step

    assert isinstance(answer, Answer)

    def line(step: Step) -> str:
        time = "" if step.seconds is None else f"{step.seconds:+.3f} s"
        frame = f"frame {step.frame}" if step.frame else ""
        return f"  {time:>12}  {frame:<12}  {step.node}  {step.text}".rstrip()

    say(f"{answer.holds.node} {answer.holds.text}")
    if answer.holds.frame:
        say(f"  since {answer.holds.seconds:+.3f} s, frame {answer.holds.frame}; {answer.links}")
    for title, steps in (("How it came there", answer.came), ("Where newer values stop", answer.stopped)):
        if steps:
            say("")
            say(f"{title}:")
            for step in steps:
                say(line(step))
