"""Check that every public function and class documents all its parameters and results: ``python tools/docstrings.py``.

numpydoc does the reading; what is left out here is private, a property, or a command whose options have a help text
each. Prints one line for each fault and leaves with 1 if there is any.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator

from numpydoc.hooks.validate_docstrings import parse_config, process_file

PACKAGES = ("smolbot", "controllers", "lookup_tables", "sim")
GENERATED = "_pb2.py"


def list_exempt(tree: ast.Module, stem: str) -> Iterator[str]:
    """Yield the dotted names of functions that need no sections: properties, commands, and functions in functions."""
    todo: list[tuple[ast.AST, str]] = [(tree, stem)]
    while todo:
        parent, name = todo.pop()
        for child in ast.iter_child_nodes(parent):
            if isinstance(child, ast.ClassDef):
                todo.append((child, f"{name}.{child.name}"))
            elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                own = f"{name}.{child.name}"
                if any("property" in ast.unparse(mark) for mark in child.decorator_list) or is_command(child):
                    yield own
                inner = (node for node in ast.walk(child) if node is not child)
                yield from (f"{own}.{node.name}" for node in inner if isinstance(node, ast.FunctionDef | ast.ClassDef))


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a function's parameters are options of a command line, which carry their help with them."""
    annotations = [ast.unparse(argument.annotation) for argument in function.args.args if argument.annotation]
    return any(text.startswith("Annotated[") or text.endswith(("Option", "Argument")) for text in annotations)


def find_faults(path: str) -> Iterator[str]:
    """Yield the faults of one file, each with its place."""
    with open(path, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    exempt = set(list_exempt(tree, path.rsplit("/", 1)[-1].removesuffix(".py")))
    for place, name, code, text in process_file(path, parse_config(".")):
        private = any(part.startswith("_") for part in name.split(".")[1:])
        if not private and name not in exempt:
            yield f"{place}: {name}: {code} {text}"


def main() -> int:
    """Check every file of the packages."""
    listed = subprocess.run(["git", "ls-files", *PACKAGES], capture_output=True, text=True, check=True).stdout.split()
    faults = [f for path in listed if path.endswith(".py") and not path.endswith(GENERATED) for f in find_faults(path)]
    print("\n".join(faults) if faults else "every public function and class documents its parameters and results")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
