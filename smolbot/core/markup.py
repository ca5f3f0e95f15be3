"""HTML from template files: text that is put into a template is escaped, what a template made is not."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Template


@cache
def load_template(path: Path) -> Template:
    """Read a jinja2 template; it may include and import those beside it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Template
        Its macros are functions of ``.module``; a name that is used in it but not given raises.

    Examples
    --------
    >>> from smolbot.runs.report.page_elements import ELEMENTS
    >>> print(ELEMENTS.paragraph("R² < 0.7"))
    <p>R² &lt; 0.7</p>
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(path.parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(path.name)
