"""CSS of an SVG drawing: which value of a property counts for an element."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree.ElementTree import Element

import cssselect2
import tinycss2

PROPERTIES = frozenset(
    ("display", "visibility", "fill", "stroke", "transform", "rotate", "scale", "d", "x", "y", "width", "height")
) | {"cx", "cy", "r", "rx", "ry"}
"""Properties that decide what is drawn, how large and how turned."""

CSS_ONLY = frozenset(("rotate", "scale"))
"""Those that are no attribute: a <text> has a rotate of another meaning."""

KEYWORDS = frozenset(("inherit", "initial", "unset", "revert", "revert-layer"))
"""Values that mean: as if nothing were said."""

SCREENS = frozenset(("", "all", "screen"))
"""Media whose rules count."""


class Node(cssselect2.ElementWrapper):  # type: ignore[misc]  # the package has no types
    """An element with its surroundings, for selectors; the package's own walks recurse, and groups may be deep."""

    @property
    def ancestors(self) -> tuple[Node, ...]:
        """Return the elements around this one, outermost first."""
        found, node = [], self.parent
        while node is not None:
            found.append(node)
            node = node.parent
        return tuple(reversed(found))

    @property
    def previous_siblings(self) -> tuple[Node, ...]:
        """Return the elements before this one, first one first."""
        found, node = [], self.previous
        while node is not None:
            found.append(node)
            node = node.previous
        return tuple(reversed(found))


class Styles:
    """All style sheets of a drawing.

    Parameters
    ----------
    sheets : iterable of str
        Text of each `<style>` element, in order.
    """

    def __init__(self, sheets: Iterable[str]) -> None:
        self._matcher = cssselect2.Matcher()
        for sheet in sheets:
            self._add(tinycss2.parse_stylesheet(sheet, skip_comments=True, skip_whitespace=True))

    def _add(self, rules: list[Any]) -> None:
        for rule in rules:
            if rule.type == "at-rule" and rule.lower_at_keyword == "media" and rule.content is not None:
                if tinycss2.serialize(rule.prelude).strip().lower() in SCREENS:
                    self._add(tinycss2.parse_rule_list(rule.content, skip_comments=True, skip_whitespace=True))
            elif rule.type == "qualified-rule":
                try:
                    selectors = cssselect2.compile_selector_list(rule.prelude)
                except cssselect2.SelectorError:  # as browsers do: a rule that is not understood is none
                    continue
                declared = _parse_declarations(rule.content)
                for selector in selectors:
                    if selector.pseudo_element is None:
                        self._matcher.add_selector(selector, declared)

    def find(self, node: Node) -> dict[str, str]:
        """Find the values of `PROPERTIES` that an element itself states: the strongest of each.

        Parameters
        ----------
        node : Node

        Returns
        -------
        dict of str
            By property. Attributes are weaker than sheets, a sheet weaker than ``style``, and ``!important`` wins.
        """
        element: Element = node.etree_element
        stated = {k: v for k, v in element.attrib.items() if k in PROPERTIES and k not in CSS_ONLY}
        declared = [d for *_, found in self._matcher.match(node) for d in found]
        declared += _parse_declarations(element.get("style", ""))
        for important in (False, True):
            stated |= {name: value for name, value, urgent in declared if urgent is important}
        return stated


def _parse_declarations(css: Any) -> list[tuple[str, str, bool]]:
    """Read the declarations of a rule that count: property, value, and whether it is ``!important``."""
    found = tinycss2.parse_blocks_contents(css, skip_comments=True, skip_whitespace=True)
    declared = [
        (d.lower_name, tinycss2.serialize(d.value).strip(), d.important) for d in found if d.type == "declaration"
    ]
    return [d for d in declared if d[0] in PROPERTIES and d[1].lower() not in KEYWORDS]
