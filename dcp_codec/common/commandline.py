"""Base of all commands of this project: lazily loaded subcommands, and the exit status of a command.

A command is a :class:`CommandLine` with a table of its subcommands; calling it is its entry point. Each subcommand is a
module with a click command named ``command``, which returns its exit status (None: 0) or raises :class:`ExpectedError`.
Importing this module costs no more than importing click.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn, TypeVar

import click
from dcp_spec.version import __version__

from .extras import REQUIREMENTS, advice
from .printable import plain

F = TypeVar("F", bound=Callable[..., Any])

#: Exit status for wrong usage and for unusable input, in every command.
UNUSABLE = 2
#: Exit status of an interrupted command, as shells report it.
_INTERRUPTED = 130
#: Help of options that several commands have; commands add the default to that of ``--profile``.
PROFILE_HELP = "Wire profile: a name ('dcp-codec profiles' lists them) or a TOML file."
ETHER_TYPE_HELP = "EtherType of the beacons, such as 0x4953.  [default: that of the profile]"
FORCE_HELP = "Replace an existing output."
LOSSY_HELP = "Write as much as the format can store."


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Write a line to standard output, or standard error; control characters are escaped."""
    click.echo(plain(text, keep="\t"), err=err, nl=nl)


class ExpectedError(Exception):
    """A failure that the user can resolve: shown as one line, with an exit status."""

    def __init__(self, message: str, status: int = UNUSABLE) -> None:
        super().__init__(message)
        self.status = status


@contextlib.contextmanager
def expected(*kinds: type[Exception]) -> Iterator[None]:
    """Report exceptions of these kinds, whose message is meant for the user, as :class:`ExpectedError`."""
    try:
        yield
    except kinds as error:
        raise ExpectedError(str(error)) from None


@contextlib.contextmanager
def writing(path: object) -> Iterator[None]:
    """Report a file that the system does not let us write as :class:`ExpectedError`."""
    try:
        yield
    except OSError as error:
        raise ExpectedError(f"{path}: cannot be written: {error.strerror or error}") from None


def choice_option(*names: str, of: Sequence[str], help: str) -> Callable[[F], F]:
    """Return an option that has one of a few values; the first of ``of`` is the default."""
    return click.option(*names, type=click.Choice(of), default=of[0], show_default=True, help=help)


def output_format(*forms: str, help: str = "Format of the output.") -> Callable[[F], F]:
    """Return the option ``--format`` (parameter ``form``) of the printed output."""
    return choice_option("-f", "--format", "form", of=forms, help=help)


def path_option(
    *names: str, metavar: str, help: str | None = None, required: bool = False, multiple: bool = False, **path: bool
) -> Callable[[F], F]:
    """Return an option that names a file or folder. ``path``: what :class:`click.Path` requires of it."""
    kind = click.Path(path_type=Path, **path)
    return click.option(*names, type=kind, metavar=metavar, help=help, required=required, multiple=multiple)


def out_option(metavar: str, help: str, *, required: bool = False, folder: bool = True) -> Callable[[F], F]:
    """Return the option ``--out`` (parameter ``out``, a path); ``folder``: it may be a folder that exists."""
    return path_option("-o", "--out", metavar=metavar, help=help, required=required, dir_okay=folder)


class CommandSection(NamedTuple):
    """Subcommands of one package. The module of a subcommand has its name, with ``_`` for ``-``."""

    heading: str
    """Heading in the help."""
    package: str
    """Package with the modules: ``dcp_codec.cli``. If it is missing, calling a subcommand reports this."""
    commands: Mapping[str, str]
    """Subcommand -> one line of help, in the order in which they are shown."""


class LazyGroup(click.Group):
    """A group whose subcommands are imported when they are called, so that ``--help`` is quick."""

    def __init__(self, sections: Sequence[CommandSection], *, name: str, help: str, epilog: str) -> None:
        settings = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
        super().__init__(name=name, help=help, epilog=epilog, context_settings=settings)
        self._sections = sections
        self._packages = {command: each.package for each in sections for command in each.commands}

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click calls with a fixed signature
        return list(self._packages)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as above
        if (package := self._packages.get(cmd_name)) is None:
            return None
        command: click.Command = importlib.import_module(f"{package}.{cmd_name.replace('-', '_')}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self._packages and not ctx.resilient_parsing:
            # Imported only for an unknown command, as click does for an unknown option.
            from difflib import get_close_matches

            if near := get_close_matches(args[0], self._packages):
                ctx.fail(f"No such command {args[0]!r}. Did you mean {' or '.join(map(repr, near))}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002 - as above
        # The sections have all that is needed; importing every module for its help would be slow.
        for each in self._sections:
            with formatter.section(each.heading):
                formatter.write_dl(list(each.commands.items()))

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _before_click():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _before_click():
            return super().invoke(ctx)


class SectionedCommand(click.Command):
    """A command with many options, whose help has sections.

    ``sections``: heading -> names of parameters, separated by spaces. Options of no section are in the last one,
    "Other options".
    """

    def __init__(self, *args: Any, sections: Mapping[str, str], **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.sections = dict(sections)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = [each for each in self.get_params(ctx) if isinstance(each, click.Option)]
        records = {each.name: record for each in options if (record := each.get_help_record(ctx))}
        for heading, names in self.sections.items():
            rows = [records.pop(name) for name in names.split() if name in records]
            with formatter.section(heading):
                formatter.write_dl(rows)
        with formatter.section("Other options"):
            formatter.write_dl(list(records.values()))


class _ReaderGone(Exception):  # noqa: N818 - not an error
    """The reader of our output has closed the pipe."""


@contextlib.contextmanager
def _before_click() -> Iterator[None]:
    """Handle a closed pipe before click does; click would end the process with status 1."""
    try:
        yield
    except BrokenPipeError as error:
        raise _ReaderGone from error
    except SystemExit as stop:
        # rich converts the error in the same way.
        if isinstance(stop.__context__, BrokenPipeError):
            raise _ReaderGone from stop
        raise


@dataclass(frozen=True, kw_only=True)
class CommandLine:
    """A command: the entry point for ``[project.scripts]``, and the handling of its end."""

    name: str
    """Name of the command: ``dcp-codec``."""
    package: str
    """Package with the modules of the subcommands: ``dcp_codec.cli``."""
    commands: Mapping[str, str]
    """Subcommand -> one line of help, in the order in which they are shown."""
    about: str
    exit_status: str
    """Meaning of each exit status, for ``--help``: "0 all good; 1 ..."."""
    failures: Mapping[type[Exception], int] = field(default_factory=lambda: MappingProxyType({}))
    """Further exceptions whose message is meant for the user -> exit status; the first match applies."""
    further: tuple[CommandSection, ...] = ()
    """Subcommands of other distributions."""
    fault_status: int = 1
    """Exit status after an internal error: an unexpected exception, shown with its traceback."""

    @property
    def subcommands(self) -> dict[str, str]:
        """All subcommands, those of other distributions last -> one line of help."""
        tables = (self.commands, *(each.commands for each in self.further))
        return {name: text for table in tables for name, text in table.items()}

    def group(self) -> click.Group:
        """Return the click group of all subcommands."""
        epilog = f"Exit status: {self.exit_status} '{self.name} COMMAND --help' has the details."
        own = CommandSection("Commands", self.package, self.commands)
        group = LazyGroup((own, *self.further), name=self.name, help=self.about, epilog=epilog)
        return click.version_option(__version__, prog_name=self.name)(group)

    def note(self, message: str) -> None:
        """Write a message to stderr, so that piped output stays undisturbed."""
        click.echo(plain(f"{self.name}: {message}", keep="\n"), err=True)

    def __call__(self, args: Sequence[str] | None = None) -> NoReturn:
        """Run with ``args`` (None: those of the process), and exit. A failure is one line on stderr and an exit status.

        A closed output pipe (``| head``) is not a failure.
        """
        _prepare_streams()
        status = self._run(args)
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            _discard_output()
        except OSError as error:
            _discard_output()
            self.note(_reason(error))
            status = UNUSABLE
        sys.exit(status)

    def _run(self, args: Sequence[str] | None) -> int:
        try:
            status: int | None = self.group().main(args, prog_name=self.name, standalone_mode=False)
        except click.exceptions.Exit as stop:
            return stop.exit_code
        except click.ClickException as error:
            told = io.StringIO()
            error.show(told)
            click.echo(plain(told.getvalue(), keep="\n"), err=True, nl=False)
            return UNUSABLE
        except click.Abort:
            return _INTERRUPTED
        except ExpectedError as error:
            self.note(str(error))
            return error.status
        except _ReaderGone:
            _discard_output()
            return 0
        except Exception as error:
            return self._failed(error)
        return status or 0

    def _failed(self, error: Exception) -> int:
        """Report an exception that no subcommand turned into an :class:`ExpectedError`; return the exit status."""
        for kind, status in self.failures.items():
            if isinstance(error, kind):
                self.note(str(error))
                return status
        package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
        if package in REQUIREMENTS:
            self.note(advice(package))
            return UNUSABLE
        if not isinstance(error, OSError):
            click.echo(plain("".join(traceback.format_exception(error)), keep="\n"), err=True, nl=False)
            return self.fault_status
        # An unexpected error of the system; most often the disk of the output is full.
        self.note(_reason(error))
        try:
            sys.stdout.flush()
        except OSError:
            _discard_output()
        return UNUSABLE


def _reason(error: OSError) -> str:
    """Return what failed in the system, and for which file."""
    # Only open() knows a file name; later errors are nearly always those of a full output.
    where = error.filename if error.filename is not None else "output cannot be written"
    return f"{where}: {error.strerror or error}"


def _prepare_streams() -> None:
    """Make the standard streams writable: replace closed descriptors, and escape characters outside the encoding."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            # The parent process closed it. The lowest free number is this one; otherwise a file of ours would get it.
            os.open(os.devnull, os.O_RDONLY if descriptor == 0 else os.O_WRONLY)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, "r" if descriptor == 0 else "w", closefd=False))
    if isinstance(sys.stdout, io.TextIOWrapper):
        # File names and descriptions may contain characters that the terminal's encoding lacks.
        sys.stdout.reconfigure(errors="backslashreplace")


def _discard_output() -> None:
    """Discard buffered output: Python would try to write it at exit, and fail."""
    # The standard output of a test has no descriptor.
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
