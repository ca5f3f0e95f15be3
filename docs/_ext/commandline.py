"""The reference of the command line, made from the commands themselves."""

from __future__ import annotations

from typing import Any, get_args

import typer
from docutils import nodes
from filekeys import table
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def root_command() -> Any:
    """``smolbot`` with all its commands, those of entry points too."""
    from smolbot.ui.cli import app as cli

    cli.register_own()
    return typer.main.get_command(cli.app)


class CommandLine(SphinxDirective):
    """A section for each command: what it does, its arguments and options."""

    def run(self) -> list[nodes.Node]:
        root = root_command()
        context = root.context_class(root, info_name="smolbot")
        found: list[nodes.Node] = []
        for name in sorted(root.list_commands(context)):
            found += _sections(root.get_command(context, name), name, context)
        return found


def _sections(command: Any, name: str, parent: Any) -> list[nodes.Node]:
    context = command.context_class(command, info_name=name, parent=parent)
    path = context.command_path
    if hasattr(command, "list_commands"):
        return [
            section
            for inner in command.list_commands(context)
            for section in _sections(command.get_command(context, inner), inner, context)
        ]
    section = nodes.section(ids=[nodes.make_id(path)], names=[path])
    section += nodes.title(text=path)
    for paragraph in (command.help or "").split("\n\n"):
        section += nodes.paragraph(text=" ".join(paragraph.split()))
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    section += nodes.literal_block(usage, usage, language="text")
    rows = [_told(parameter) for parameter in command.params]
    if rows := [row for row in rows if row[0] != "--help"]:
        section += table(("option", "default", "meaning"), (32, 12, 60), rows, literal=(0, 1))
    return [section]


def _told(parameter: Any) -> tuple[str, str, str]:
    """How it is written, its default, and what it means."""
    if parameter.param_type_name == "argument":
        return _metavar(parameter), "" if parameter.required else _default(parameter), parameter.help or ""
    written = ", ".join([*parameter.opts, *parameter.secondary_opts])
    if not parameter.is_flag:
        written += f" {_metavar(parameter)}"
    return written, "" if parameter.is_flag else _default(parameter), parameter.help or ""


_KINDS = {"str": "TEXT", "int": "INTEGER", "float": "NUMBER", "Path": "PATH", "list[str]": "TEXT"}


def _metavar(parameter: Any) -> str:
    """What stands for the value, as `--help` has it."""
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
    return str(value)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("commandline", CommandLine)
    return {"version": "1", "parallel_read_safe": True}
