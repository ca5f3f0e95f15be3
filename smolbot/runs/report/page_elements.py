"""A page of one file, from the templates beside this module. Nothing in it is fetched from anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.core.markup import load_template
from smolbot.runs.report.svg import DARK

if TYPE_CHECKING:
    from markupsafe import Markup

TEMPLATES = Path(__file__).with_name("templates")

ELEMENTS: Any = load_template(TEMPLATES / "elements.html").module
"""Macros of ``elements.html``: tables, tiles, figures, badges."""


@dataclass
class Section:
    """A part of a page.

    Attributes
    ----------
    anchor : str
        Target of links within the page.
    title : str
    body : list of Markup
        Elements, in order.
    """

    anchor: str
    title: str
    body: list[Markup] = field(default_factory=list)

    def add(self, element: Markup) -> Section:
        """Append an element.

        Parameters
        ----------
        element : str
            HTML.

        Returns
        -------
        Section
            The same section.
        """
        self.body.append(element)
        return self

    def add_figure(self, svg: Markup, caption: str) -> Section:
        """Append a figure with its caption.

        Parameters
        ----------
        svg : Markup
        caption : str
            How to read the figure.

        Returns
        -------
        Section
            The same section.
        """
        return self.add(ELEMENTS.figure(svg, caption))

    def add_paragraph(self, line: str, kind: str = "") -> Section:
        """Append a paragraph.

        Parameters
        ----------
        line : str
        kind : str
            Class of the style sheet.

        Returns
        -------
        Section
            The same section.
        """
        return self.add(ELEMENTS.paragraph(line, kind))

    def add_missing_note(self, why: str) -> Section:
        """Append a paragraph on why something is not shown.

        Parameters
        ----------
        why : str
            Plain text.

        Returns
        -------
        Section
            The same section.
        """
        return self.add_paragraph(why, "missing")


def render_page(
    title: str, heading: str, lead: Sequence[Markup], sections: Sequence[Section], *, warning: str = ""
) -> str:
    """Render a complete page.

    Parameters
    ----------
    title : str
        Of the browser's tab.
    heading : str or Markup
    lead : sequence of Markup
        Elements under the heading.
    sections : sequence of Section
        Links to all of them are above them.
    warning : str
        Stands above everything else.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    return load_template(TEMPLATES / "page.html").render(
        title=title, heading=heading, lead=lead, sections=sections, warning=warning, figure_colors=DARK
    )
