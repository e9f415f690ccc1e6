"""``dcp-codec profiles``: list the wire profiles, show one, or draft a new one."""

from __future__ import annotations

import json
from pathlib import Path

import click
import msgspec
from dcp_spec.profile.loading import ProfileError, load_profile, profile_names
from dcp_spec.profile.usability import refusal

from dcp_codec.common.commandline import ExpectedError, expected, out_option, output_format, writing

from . import main

#: Number of frames from which a draft is made and against which it is checked.
_FRAMES = 2000


def _ether_type(_ctx: click.Context, _param: click.Parameter, value: str | None) -> int | None:
    if value is None:
        return None
    # Imported on use: the shared module imports the codec, which a list of names does not need.
    from .common import ether_type

    return ether_type(_ctx, _param, value)


@click.command(
    "profiles",
    epilog="Every key of a profile file: docs/profile-reference.md. Exit status of 'profiles new': 0 if the draft "
    "decodes all sampled frames, 1 if some fail.",
)
@click.argument("name", required=False, metavar="[NAME|FILE|new]")
@click.argument("new_name", required=False, metavar="[NEW-NAME]")
@output_format("text", "json", "toml")
@click.option("--from", "recording", metavar="RECORDING", help="With new: draft a profile for this recording.")
@out_option("FILE", "With new: write the draft to FILE.  [default: NEW-NAME.toml]")
@click.option(
    "--ether-type", callback=_ether_type, metavar="HEX", help="With new: EtherType of the beacons, such as 0x4953."
)
@click.option("--force", is_flag=True, help="With new: replace an existing output.")
def command(
    name: str | None,
    new_name: str | None,
    form: str,
    recording: str | None,
    out: Path | None,
    ether_type: int | None,
    *,
    force: bool,
) -> int:
    """List the built-in wire profiles, show one with all that it inherits, or draft one.

    \b
    dcp-codec profiles                                  list them
    dcp-codec profiles cpp-2.0                          show the layout
    dcp-codec profiles mine.toml                        check a file of your own
    dcp-codec profiles new mine --from flight.pcap      draft mine.toml

    A draft extends the built-in profile that explains the recording best, describes what that one does not explain, and
    is checked against the recording.
    """
    if name == "new":
        if new_name is None or recording is None:
            raise click.UsageError("give a name and a recording: dcp-codec profiles new NAME --from RECORDING")
        return _new(new_name, recording, out or Path(f"{new_name}.toml"), ether_type, force=force)
    if new_name is not None or recording is not None or out is not None:
        raise click.UsageError(
            "a second name, --from and --out belong to: dcp-codec profiles new NAME --from RECORDING"
        )
    with expected(ProfileError):
        if name is not None:
            return _show(name, form)
        found = [load_profile(each) for each in profile_names()]
    if form == "json":
        click.echo(json.dumps([{"name": each.name, "title": each.title} for each in found], indent=2))
        return 0
    width = max(len(each.name) for each in found)
    for each in found:
        click.echo(f"{each.name:<{width}}  {each.title}")
    return 0


def _show(name: str, form: str) -> int:
    profile = load_profile(name)
    if form == "json":
        click.echo(msgspec.json.format(msgspec.json.encode(profile), indent=2).decode())
    elif form == "toml":
        from dcp_codec.export.tomltext import profile_toml

        click.echo(profile_toml(profile), nl=False)
    else:
        from dcp_codec.codec import Codec
        from dcp_codec.export.markdown import format_tables

        click.echo(format_tables(Codec(profile)))
    if (reason := refusal(profile)) is not None:
        main.note(reason)
    return 0


def _new(name: str, recording: str, out: Path, ether_type: int | None, *, force: bool) -> int:
    from dcp_codec.analysis.guess import sample
    from dcp_codec.analysis.profile_draft import draft_profile
    from dcp_codec.common.atomic_write import write_whole

    from .common import open_input, report_capture_problems

    if not name.isprintable() or "/" in name:
        raise ExpectedError(f"{name!r} cannot be the name of a profile: use letters, digits, - and .")
    if out.exists() and not force:
        raise ExpectedError(f"{out} exists: give --force to replace it, or --out FILE for another file")
    with open_input(recording) as reader:
        frames, _ = sample(reader, _FRAMES, ether_type=ether_type)
        status = report_capture_problems(reader, recording)
    try:
        draft = draft_profile(name, frames, recording, ether_type=ether_type)
    except ValueError as error:
        raise ExpectedError(f"{recording}: {error}") from None
    with writing(out):
        write_whole(out, draft.text.encode())
    click.echo(f"{out}: extends {draft.extends}")
    click.echo(f"  {draft.decoded} of {draft.frames} frames decode with it, {draft.before} with {draft.extends} itself")
    for each in draft.left:
        click.echo(f"  not explained yet: {each.text} (first in frame {each.frame})")
    click.echo(f"  next: check the file, then dcp-codec decode {recording} --profile {out}")
    return max(status, int(draft.decoded < draft.frames))
