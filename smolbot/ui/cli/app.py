"""``smolbot``: the commands of every installed package, and the exit codes of errors."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

import typer
from typer.core import TyperGroup

# Small matrices gain nothing from a linear algebra library's threads, and stall when cores are shared.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.core.version import __version__
from smolbot.errors import InterlockError, OperatorStopError, PluginError, RigError, SmolbotError, report_plugin_errors
from smolbot.flight.safety.stop_signals import CTRL_C_REASON

DONE, VERDICT_FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 3


class CommandGroup(TyperGroup):  # type: ignore[misc,unused-ignore]
    """Command group with our own commands and those of the entry points ``smolbot.commands``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """List the names of all commands, our own first.

        Parameters
        ----------
        ctx : click.Context

        Returns
        -------
        list of str
        """
        own = super().list_commands(ctx)
        return own + [name for name in list_plugins("commands") if name not in own]

    def invoke(self, ctx: Any) -> Any:
        """Run a command; Ctrl-C outside of a flight ends it with our message and exit code, not with typer's.

        Parameters
        ----------
        ctx : click.Context

        Returns
        -------
        object
            What the command returns.

        Raises
        ------
        OperatorStopError
            On Ctrl-C.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise OperatorStopError(f"{str(stop) or CTRL_C_REASON}; nothing was moving") from None

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name; one of an entry point is loaded first.

        Parameters
        ----------
        ctx : click.Context
        cmd_name : str

        Returns
        -------
        click.Command or None
            None if there is none. For one that cannot be loaded, a command that prints why.
        """
        found = super().get_command(ctx, cmd_name)
        if found is not None:
            return found
        if cmd_name not in list_plugins("commands"):
            return None
        try:
            loaded = load_plugin("commands", cmd_name)
        except PluginError as error:
            return _make_broken_command(cmd_name, str(error))
        app = loaded
        if not isinstance(loaded, typer.Typer):
            app = typer.Typer(add_completion=False)
            app.command(cmd_name)(_name_in_errors(loaded))
        command = typer.main.get_command(app)
        command.name = cmd_name
        return command


def _name_in_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap the function of a command so that an unexpected error of a lab's own names it."""

    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Any:
        with report_plugin_errors("Command", command, ""):
            return command(*arguments, **options)

    return call


def _make_broken_command(name: str, message: str) -> Any:
    """Make a command that prints why another one could not be loaded, so that it does not hide the others."""

    def explain(**_: Any) -> None:
        typer.echo(message, err=True)
        raise typer.Exit(BAD_INPUT)

    app = typer.Typer(add_completion=False)
    whatever = {"ignore_unknown_options": True, "allow_extra_args": True}
    app.command(name, help="Cannot be loaded; call it to see why.", context_settings=whatever)(lambda: explain())
    return typer.main.get_command(app)


app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # the rich help costs a quarter of the time that --help may take
    help="Steers a magnetic millirobot along a path and localizes it only from magnetic sensors.",
)


def _print_version(value: bool) -> None:
    if value:
        typer.echo(f"smolbot {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
) -> None:
    """Steers a magnetic millirobot along a path and localizes it only from magnetic sensors."""


def register_own_commands() -> None:
    """Add the commands that are not entry points; once, however often it is called."""
    if app.registered_commands:
        return
    from smolbot.ui.cli import check, console, missions
    from smolbot.ui.cli.run import run

    app.command("run")(run)
    missions.register(app)
    check.register(app)
    console.register(app)


def main() -> None:
    """Run the command line; our own errors print one message and set the exit code."""
    register_own_commands()
    try:
        app()
    except (InterlockError, RigError) as error:
        _fail(str(error), STOPPED)
    except SmolbotError as error:
        _fail(str(error), BAD_INPUT)
    except ValueError as error:
        if type(error).__module__.split(".")[0] != "lookup_tables":
            raise
        _fail(str(error), BAD_INPUT)
    except KeyboardInterrupt as stop:  # before a command has begun, or after
        _fail(f"{str(stop) or CTRL_C_REASON}; nothing was moving", STOPPED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(VERDICT_FAILED)


def _fail(message: str, code: int) -> None:
    print(message, file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
