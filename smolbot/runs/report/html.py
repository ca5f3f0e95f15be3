"""A page of one file: headings, figures with captions, tables. Nothing here is fetched from anywhere."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from smolbot.runs.report.svg import css_colors


def text(value: object) -> str:
    """Any text, so that it says in a page what it says."""
    return html.escape(str(value), quote=True)


@dataclass
class Section:
    """A part of a page.

    Attributes
    ----------
    anchor : str
        What links within the page call it.
    title : str
    body : list of str
        Elements, in order.
    """

    anchor: str
    title: str
    body: list[str] = field(default_factory=list)

    def figure(self, svg: str, how: str) -> Section:
        """Append a figure and how to read it (elements are allowed)."""
        self.body.append(f"<figure>{svg}<figcaption><b>How to read this.</b> {how}</figcaption></figure>")
        return self

    def say(self, line: str, kind: str = "") -> Section:
        """Append a paragraph (elements are allowed)."""
        self.body.append(f'<p class="{kind}">{line}</p>' if kind else f"<p>{line}</p>")
        return self

    def missing(self, why: str) -> Section:
        """Say why something is not shown."""
        return self.say(text(why), "missing")

    def add(self, element: str) -> Section:
        """Append an element."""
        self.body.append(element)
        return self


def table(
    rows: Iterable[Sequence[object]], header: Sequence[str] = (), *, numbers: bool = False, wide: bool = False
) -> str:
    """A table; cells are escaped. With `numbers`, all columns but the first stand to the right."""
    kind = " ".join(name for name, on in (("numbers", numbers), ("wide", wide)) if on)
    head = f"<thead><tr>{''.join(f'<th>{text(cell)}</th>' for cell in header)}</tr></thead>" if header else ""
    lines = "".join(
        f"<tr>{''.join(f'<{tag}>{text(cell)}</{tag}>' for tag, cell in zip(_tags(len(row)), row, strict=True))}</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table class="{kind}">{head}<tbody>{lines}</tbody></table></div>'


def _tags(n: int) -> list[str]:
    return ["th", *["td"] * (n - 1)]


def tiles(entries: Iterable[tuple[str, str, str]]) -> str:
    """Key figures: value, unit, and what they are."""
    cells = "".join(
        f'<div class="tile"><span class="value">{text(value)}<small>{text(unit)}</small></span>'
        f'<span class="what">{text(what)}</span></div>'
        for value, unit, what in entries
    )
    return f'<div class="tiles">{cells}</div>'


def folded(title: str, element: str) -> str:
    """Something that is opened by a click, and open in print."""
    return f"<details><summary>{text(title)}</summary>{element}</details>"


def badge(verdict: str) -> str:
    """``passed`` or ``failed`` as a mark."""
    return f'<span class="badge {text(verdict)}">{text(verdict)}</span>'


def page(title: str, heading: str, lead: Sequence[str], sections: Sequence[Section], *, warning: str = "") -> str:
    """The whole page: `heading` and `lead` (elements) on top, then links to all sections, then these."""
    links = "".join(f'<a href="#{s.anchor}">{text(s.title)}</a>' for s in sections)
    parts = "".join(
        f'<section id="{s.anchor}"><h2><a href="#{s.anchor}">{text(s.title)}</a></h2>{"".join(s.body)}</section>'
        for s in sections
    )
    warned = f'<p class="warning">{text(warning)}</p>' if warning else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{_css()}</style></head><body><main>"
        f"<header>{warned}<h1>{heading}</h1>{''.join(lead)}</header><nav>{links}</nav>{parts}</main></body></html>\n"
    )


def _css() -> str:
    light, dark = css_colors()
    rules = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    own_light = "--page: #ffffff; --text: #22262b; --soft: #5c636d; --line: #e1e4e8; --panel: #f6f7f9; --link: #1b4965;"
    own_dark = "--page: #16191d; --text: #dfe3e8; --soft: #9aa1ab; --line: #31363d; --panel: #1e2227; --link: #8cc3ec;"
    return (
        f":root {{ {own_light} {light} color-scheme: light dark; }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {own_dark} {dark} }} }}\n\n{rules}"
    )
