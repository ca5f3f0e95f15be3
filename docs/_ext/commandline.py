"""Write the reference of the command line from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

import typer
from filekeys import to_markdown, write_table


def make_root_command() -> Any:
    """Make ``smolbot`` with all its commands, those of entry points too.

    Returns
    -------
    click Group
    """
    from smolbot.ui.cli import app as cli

    cli.register_own_commands()
    return typer.main.get_command(cli.app)


def write_commands() -> str:
    """Write a section for each command: what it does, its arguments and options.

    Returns
    -------
    str
        Markdown.
    """
    root = make_root_command()
    context = root.context_class(root, info_name="smolbot")
    return "\n\n".join(
        line
        for name in sorted(root.list_commands(context))
        for line in _sections(root.get_command(context, name), name, context)
    )


def _sections(command: Any, name: str, parent: Any) -> Iterator[str]:
    context = command.context_class(command, info_name=name, parent=parent)
    if hasattr(command, "list_commands"):
        for inner in command.list_commands(context):
            yield from _sections(command.get_command(context, inner), inner, context)
        return
    yield f"## {context.command_path}"
    yield from (to_markdown(" ".join(paragraph.split())) for paragraph in (command.help or "").split("\n\n"))
    yield "```text\n" + " ".join([context.command_path, *command.collect_usage_pieces(context)]) + "\n```"
    rows = [_describe(parameter) for parameter in command.params if "--help" not in parameter.opts]
    if rows:
        yield write_table(("option", "default", "meaning"), rows)


def _describe(parameter: Any) -> tuple[str, str, str]:
    """Name and placeholder of a parameter, its default, and its meaning."""
    if parameter.param_type_name == "argument":
        return (
            f"`{_metavar(parameter)}`",
            "" if parameter.required else _default(parameter),
            to_markdown(parameter.help or ""),
        )
    written = ", ".join([*parameter.opts, *parameter.secondary_opts])
    if parameter.is_flag:
        return f"`{written}`", "", to_markdown(parameter.help or "")
    return f"`{written} {_metavar(parameter)}`", _default(parameter), to_markdown(parameter.help or "")


_KINDS = {"str": "TEXT", "int": "INTEGER", "float": "NUMBER", "list[str]": "TEXT", "PlantModel": "PLANT"}


def _metavar(parameter: Any) -> str:
    """The placeholder of a value, as in `--help`."""
    if parameter.metavar:
        return str(parameter.metavar)
    if parameter.param_type_name == "argument":
        return str(parameter.name).upper()
    kind = parameter.type_descriptor.annotation
    name = str(kind) if get_args(kind) else kind.__name__
    return _KINDS.get(name, name.upper())


def _default(parameter: Any) -> str:
    value = parameter.default
    if value is None or callable(value) or value in ([], ()) or type(value).__name__ == "Sentinel":
        return "needed" if parameter.required else ""
    return f"`{value}`"
