"""What the commands of this project share: subcommands that load when they are called, and how a command ends.

A command is a :class:`CommandLine` with a table of its subcommands; calling it is its entry point. Each subcommand is a
module with a click command called ``command``, which returns its exit status (None: 0) or raises
:class:`ExpectedError`. Nothing here costs more at import than click.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NoReturn

import click
from dcp_spec.version import __version__

from .extras import EXTRAS, advice
from .printable import plain

#: The status of wrong usage, and of input that cannot be used, in every command.
UNUSABLE = 2
#: The status of a command that was interrupted, as shells give it.
_INTERRUPTED = 130


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Write a line to standard output, or standard error; what could control a terminal is shown as an escape."""
    click.echo(plain(text, keep="\t"), err=err, nl=nl)


class ExpectedError(Exception):
    """A failure that the user can do something about: shown as one line, with an exit status."""

    def __init__(self, message: str, status: int = UNUSABLE) -> None:
        super().__init__(message)
        self.status = status


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called, so that ``--help`` stays quick.

    ``table``: subcommand -> one line of help; the module has the name of the subcommand, with ``_`` for ``-``.
    """

    def __init__(self, package: str, table: Mapping[str, str], *, name: str, help: str, epilog: str) -> None:
        settings = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
        super().__init__(name=name, help=help, epilog=epilog, context_settings=settings)
        self._package = package
        self._table = dict(table)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click calls with a fixed signature
        return list(self._table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as above
        if cmd_name not in self._table:
            return None
        command: click.Command = importlib.import_module(f"{self._package}.{cmd_name.replace('-', '_')}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002 - as above
        # Only the table is needed here; importing every module for its help would cost what laziness saves.
        with formatter.section("Commands"):
            formatter.write_dl(list(self._table.items()))

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _before_click():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _before_click():
            return super().invoke(ctx)


class _ReaderGone(Exception):  # noqa: N818 - not an error
    """Whoever read our output has closed it."""


@contextlib.contextmanager
def _before_click() -> Iterator[None]:
    """Take a closed pipe out of click's hands, which would end the process with status 1."""
    try:
        yield
    except BrokenPipeError as error:
        raise _ReaderGone from error
    except SystemExit as stop:
        # rich does the same by itself.
        if isinstance(stop.__context__, BrokenPipeError):
            raise _ReaderGone from stop
        raise


@dataclass(frozen=True, kw_only=True)
class CommandLine:
    """A command: what ``[project.scripts]`` names, and what ends it."""

    name: str
    """As it is typed: ``dcp-codec``."""
    package: str
    """Where the modules of the subcommands are: ``dcp_codec.cli``."""
    commands: Mapping[str, str]
    """Subcommand -> one line of help, in the order in which they are shown."""
    about: str
    exit_status: str
    """What each exit status means, for ``--help``: "0 all good; 1 ..."."""
    failures: Mapping[type[Exception], int] = field(default_factory=lambda: MappingProxyType({}))
    """Exceptions beside :class:`ExpectedError` whose message is for people -> exit status; the first that fits."""
    extras: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """Packages that another extra installs for this command than :data:`~dcp_codec.common.extras.EXTRAS` says."""
    fault_status: int = 1
    """The status when the command itself is at fault: an exception that nobody expected, shown with its traceback."""

    def group(self) -> click.Group:
        """The click group of all subcommands."""
        epilog = f"Exit status: {self.exit_status} '{self.name} COMMAND --help' tells more."
        group = LazyGroup(self.package, self.commands, name=self.name, help=self.about, epilog=epilog)
        return click.version_option(__version__, prog_name=self.name)(group)

    def note(self, message: str) -> None:
        """Tell something on stderr, where it does not disturb output that is piped on."""
        click.echo(plain(f"{self.name}: {message}", keep="\n"), err=True)

    def __call__(self, args: Sequence[str] | None = None) -> NoReturn:
        """Run with ``args`` (None: those of the process), and exit: every failure is one line on stderr and a status.

        A reader of the output that has seen enough (``| head``) is no failure.
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
        """Show an exception that no subcommand turned into an :class:`ExpectedError`; returns the exit status."""
        for kind, status in self.failures.items():
            if isinstance(error, kind):
                self.note(str(error))
                return status
        package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
        if extra := self.extras.get(package, EXTRAS.get(package)):
            self.note(advice(package, extra))
            return UNUSABLE
        if not isinstance(error, OSError):
            click.echo(plain("".join(traceback.format_exception(error)), keep="\n"), err=True, nl=False)
            return self.fault_status
        # What a subcommand did not foresee of the system: most often the place where the output goes is full.
        self.note(_reason(error))
        try:
            sys.stdout.flush()
        except OSError:
            _discard_output()
        return UNUSABLE


def _reason(error: OSError) -> str:
    """What the system did not do, and where."""
    # Only opening knows a name; what comes later is nearly always that output finds no room.
    where = error.filename if error.filename is not None else "output cannot be written"
    return f"{where}: {error.strerror or error}"


def _prepare_streams() -> None:
    """Have standard streams that can be written to, whoever started the process, with whatever characters."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            # Closed by whoever started us; the lowest free number is this one, and no file of ours gets it.
            os.open(os.devnull, os.O_RDONLY if descriptor == 0 else os.O_WRONLY)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, "r" if descriptor == 0 else "w", closefd=False))
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Names of files and descriptions may hold what the encoding of a terminal cannot show.
        sys.stdout.reconfigure(errors="backslashreplace")


def _discard_output() -> None:
    """Let what is still buffered go nowhere: Python would try, and fail, to write it when it ends."""
    # A test's standard output has no descriptor.
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
