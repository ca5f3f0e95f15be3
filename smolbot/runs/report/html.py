"""A page of one file: headings, figures with captions, tables. Nothing here is fetched from anywhere."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

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
    own_light = "--page: #ffffff; --text: #22262b; --soft: #5c636d; --line: #e1e4e8; --panel: #f6f7f9; --link: #1b4965;"
    own_dark = "--page: #16191d; --text: #dfe3e8; --soft: #9aa1ab; --line: #31363d; --panel: #1e2227; --link: #8cc3ec;"
    return (
        f":root {{ {own_light} {light} color-scheme: light dark; }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {own_dark} {dark} }} }}\n{_RULES}"
    )


_RULES = """
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 28px 28px 60px; }
h1 { font-size: 27px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 19px; margin: 0 0 10px; }
h2 a { color: inherit; text-decoration: none; }
h2 a:hover::after { content: " #"; color: var(--soft); }
h3 { font-size: 15px; margin: 18px 0 6px; }
p { margin: 6px 0; max-width: 82ch; }
header p { color: var(--soft); }
nav { display: flex; flex-wrap: wrap; gap: 4px 16px; padding: 10px 0; margin: 14px 0 8px;
  border-top: 1px solid var(--line); border-bottom: 1px solid var(--line); font-size: 13.5px; }
nav a, a { color: var(--link); }
nav a { text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { padding-top: 26px; }
figure { margin: 6px 0 12px; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { color: var(--soft); font-size: 13.5px; max-width: 96ch; margin-top: 6px; }
figcaption b { color: var(--text); font-weight: 600; }
.badge { display: inline-block; font-size: 15px; font-weight: 600; padding: 2px 12px; border-radius: 20px;
  vertical-align: 4px; margin-left: 8px; color: #ffffff; background: #6b7280; letter-spacing: 0; }
.badge.passed { background: #2e7d4f; }
.badge.failed { background: #c0392b; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(116px, 1fr)); gap: 10px; margin: 16px 0 4px; }
.tile { background: var(--panel); border: 1px solid var(--line); border-radius: 8px; padding: 9px 10px; }
.tile .value { display: block; font-size: 20px; font-weight: 600; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
.tile .value small { font-size: 13px; font-weight: 400; color: var(--soft); margin-left: 4px; }
.tile .what { color: var(--soft); font-size: 12.5px; line-height: 1.3; display: block; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13.5px; margin: 8px 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 4px 18px 4px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
thead th { color: var(--soft); font-weight: 500; font-size: 12.5px; }
tbody th { font-weight: 500; white-space: nowrap; }
td .badge { font-size: 12.5px; margin: 0; vertical-align: 0; padding: 1px 10px; }
.numbers td, .numbers thead th:not(:first-child) { text-align: right; }
.wide { width: 100%; }
details { margin: 8px 0; border: 1px solid var(--line); border-radius: 8px; padding: 6px 12px; }
summary { cursor: pointer; font-weight: 500; }
pre { font: 12px/1.45 ui-monospace, Consolas, "DejaVu Sans Mono", monospace; overflow-x: auto; white-space: pre-wrap; }
.warning { background: #f2a541; color: #22262b; padding: 10px 14px; border-radius: 8px; font-weight: 600;
  max-width: none; }
header p.warning { color: #22262b; }
.missing { color: var(--soft); border-left: 3px solid var(--line); padding-left: 12px; font-style: italic; }
.formula { font-family: "Cambria Math", "STIX Two Math", Georgia, serif; font-size: 16px; padding: 2px 0 2px 16px; }
footer { color: var(--soft); font-size: 12.5px; margin-top: 30px; }
@media print {
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { font-size: 11px; } main { max-width: none; padding: 0; } nav { display: none; }
  section, figure, table, .tile { break-inside: avoid; } h2 { break-after: avoid; }
  details > *:not(summary) { display: block; }
  details::details-content { content-visibility: visible; block-size: auto; }
  .scroll { overflow: visible; }
}
"""
