"""``console`` and ``stop``: a page that shows missions, and a command that stops all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.show import echo_json, print_table


def register(app: typer.Typer) -> None:
    """Add the commands of this module.

    Parameters
    ----------
    app : typer.Typer
    """
    app.command("console")(console)
    app.command("stop")(stop)


def console(
    host: Annotated[
        str, typer.Option(help="Address to listen on; one that others can reach gets a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the page.")] = 8420,
    token: Annotated[
        str | None, typer.Option(help="Token that a browser must show; made and printed where one is needed.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="Folder of the runs to browse.")] = Path("runs"),
    follow: Annotated[bool, typer.Option("--follow", help="End once no mission and no page is left.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object once the page is open.")] = False,
) -> None:
    """Open a page to watch, start, pause and stop missions, draw paths, and browse runs."""
    try:
        from smolbot.ui.console.open_console import OpenConsole, watch_end_signals
    except ImportError as error:
        raise InputError(
            f"The console needs viser, which is not installed ({error}): pip install smolbot[console]"
        ) from error
    with watch_end_signals() as over:
        opened = OpenConsole(host, port, token, runs, _print_line)
        try:
            rows = [("page", opened.access.address), ("runs", str(runs.absolute())), ("to end it", "Ctrl-C")]
            print_table("console", rows, err=True)
            if json:
                echo_json(
                    {"address": opened.access.address, "link": opened.console.link, "process": opened.console.process}
                )
            opened.wait(over, follow=follow)
        finally:
            opened.close()


def stop(
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")] = False,
) -> None:
    """Stop every mission that is connected to a console of this user: outputs to zero at once."""
    from smolbot.ui.link.console_server import request_stop
    from smolbot.ui.link.consoles import connect_to_all
    from smolbot.ui.link.frames import LinkError

    answers = []
    silent: list[str] = []
    found = 0
    for each, sock in connect_to_all(silent):
        found += 1
        with sock:
            try:
                answers += request_stop(sock, "smolbot stop")
            except LinkError as error:
                silent.append(f"{each.address}: {error}")
    rows = [
        (
            str(one["mission"]),
            f"stopped, outputs at zero after {one['took_ms']:.1f} ms" if one["stopped"] else "NO ANSWER",
        )
        for one in answers
    ]
    if json:
        echo_json({"stopped": answers, "silent": silent})
    if rows:
        print_table("stopped", rows, err=json)
    if silent or not all(one["stopped"] for one in answers):
        typer.echo("\n".join([*silent, "A mission that loses its console stops by itself within 2 s."]), err=True)
        raise typer.Exit(3)
    if not found:
        raise InputError("No console of this user runs, so none watches a mission. One without --live ends by Ctrl-C.")
    if not answers:
        typer.echo("No mission flies.", err=True)


def _print_line(line: str) -> None:
    typer.echo(line, err=True)
