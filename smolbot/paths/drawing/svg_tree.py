"""The shapes that an SVG document draws, each with its place on the page: groups, nested drawings, and uses."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.paths.drawing.svg_shapes import SHAPES, make_path_data
from smolbot.paths.drawing.svg_styles import Node, Styles
from smolbot.paths.drawing.svg_units import (
    Box,
    compute_view,
    make_shift,
    parse_length,
    parse_transform,
    parse_view_box,
)

MAX_USED = 10_000
"""Largest number of elements that all <use> together may show: ten of ten of ten … would be drawn for ever."""

NAMESPACES = ("{http://www.w3.org/2000/svg}", "")
"""Of elements that are SVG; drawings written by hand may name none."""

GROUPS = ("g", "a", "svg", "switch")
"""Elements whose children are drawn."""

HREFS = ("href", "{http://www.w3.org/1999/xlink}href")
"""Attributes by which a <use> names what it shows."""

NO_BOX = Box(None, None)
"""Around the outermost <svg>: its window, which no robot has."""

LANGUAGE = "en"
"""Language whose part of a <switch> is drawn."""


@dataclass(frozen=True)
class DrawnShape:
    """One shape of a drawing.

    Attributes
    ----------
    kind : str
        Its element: ``"rect"``, ….
    id : str
        Empty without one.
    data : str
        Data of the path that it draws, in its own units.
    matrix : ndarray, shape (3, 3)
        From its own units to pixels of the page.
    asked : bool
        It, or what holds or uses it, has the id that was asked for.
    hidden : str
        What hides it; empty where it can be seen.
    painted : bool
        It has a fill or a stroke.
    """

    kind: str
    id: str
    data: str
    matrix: FloatArray
    asked: bool
    hidden: str
    painted: bool

    @property
    def name(self) -> str:
        """Its name for messages."""
        return f"element '{self.id}'" if self.id else f"its {self.kind}"


@dataclass(frozen=True)
class _Place:
    """What an element takes from those around it."""

    matrix: FloatArray = field(default_factory=lambda: np.eye(3))
    box: Box = NO_BOX
    asked: bool = False
    gone: str = ""
    visibility: str = "visible"
    fill: str = "black"
    stroke: str = "none"
    uses: tuple[str, ...] = ()
    size: dict[str, str] | None = None  # of a <use> that shows a <symbol> or an <svg>


class Document:
    """An SVG file.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    kinds : dict of str
        Element that has each id, such as ``"rect"``.

    Raises
    ------
    InputError
        With file and line: a file that cannot be read, is no XML or no SVG.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            tree = ElementTree.parse(path)
        except ElementTree.ParseError as error:
            raise InputError(f"{path}:{error.position[0]}: not valid XML: {error}.") from error
        except (OSError, UnicodeDecodeError, LookupError, ValueError) as error:  # an encoding that is none, too
            raise InputError(f"{path}: cannot be read: {error}.") from error
        self._root = Node.from_xml_root(tree)
        if _get_tag(self._root) != "svg":
            raise InputError(f"{path}: is no SVG: its outermost element is not <svg>.")
        self._nodes: dict[str, Node] = {}
        sheets = []
        for node in self._root.iter_subtree():
            if node.id:
                self._nodes.setdefault(node.id, node)
            if _get_tag(node) == "style":
                sheets.append("".join(node.etree_element.itertext()))
        self.kinds = {name: _get_tag(node) for name, node in self._nodes.items()}
        self._styles = Styles(sheets)
        self._used = 0

    def list_shapes(self, element: str | None = None) -> list[DrawnShape]:
        """List the shapes that are drawn, or only hidden, in the order of the document.

        Parameters
        ----------
        element : str, optional
            Id that was asked for: shapes in it are marked. Without one, all are.

        Returns
        -------
        list of DrawnShape

        Raises
        ------
        InputError
            With file and element: an attribute that cannot be read, a <use> that shows nothing or itself, and more
            than `MAX_USED` elements in uses.
        """
        found = []
        self._used = 0
        waiting = [(self._root, _Place(asked=element is None))]
        while waiting:  # no recursion: groups may be thousands deep
            node, place = waiting.pop()
            with self._name(node):
                if not _is_offered(node):
                    continue
                tag, stated = _get_tag(node), self._styles.find(node)
                place = _enter(node, place, stated, element)
                if tag in SHAPES:
                    found.append(_make_shape(node, place, stated))
                elif tag == "use":
                    waiting.append(self._follow(node, place, stated))
                elif tag in GROUPS or (tag == "symbol" and place.size is not None):
                    children, inside = _list_children(node), replace(place, size=None)
                    if tag in ("svg", "symbol"):
                        inside = _enter_viewport(node, place, stated)
                    waiting += [(child, inside) for child in reversed(children)]
        return found

    def _follow(self, node: Node, place: _Place, stated: dict[str, str]) -> tuple[Node, _Place]:
        """Return what a <use> shows, and where."""
        reference = next((node.etree_element.get(name) for name in HREFS if name in node.etree_element.attrib), "")
        target = self._nodes.get(reference.removeprefix("#")) if reference.startswith("#") else None
        if target is None:
            raise InputError(f"<use> shows '{reference}', and this file holds no element of that id")
        if reference in place.uses:
            raise InputError(f"<use> shows '{reference}', which shows that <use> again: it would never end")
        self._used += sum(1 for _ in target.iter_subtree())
        if self._used > MAX_USED:
            raise InputError(f"all <use> together show more than {MAX_USED} elements, the most that is read")
        shift = make_shift(*(parse_length(stated.get(n, "0"), w) for n, w in zip("xy", place.box, strict=True)))
        size = {name: stated[name] for name in ("width", "height") if stated.get(name, "auto") != "auto"}
        shown = Node(target.etree_element, None, 0, None, False)  # selectors see no further up than what is shown
        return shown, replace(place, matrix=place.matrix @ shift, uses=(*place.uses, reference), size=size)

    @contextmanager
    def _name(self, node: Node) -> Iterator[None]:
        """Put file and element before what is raised."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self._path}: {_format_name(node)}: {error}.") from error


def _get_tag(node: Node) -> str:
    """Return the name of an SVG element; empty for one of another kind."""
    tag = node.etree_element.tag
    for space in NAMESPACES:
        if isinstance(tag, str) and tag.startswith(space) and "{" not in tag[len(space) :]:
            return tag[len(space) :]
    return ""


def _format_name(node: Node) -> str:
    return f"element '{node.id}'" if node.id else f"a <{_get_tag(node)}> without an id"


def _is_offered(node: Node) -> bool:
    """Return whether an element is for every program, and for our language."""
    element = node.etree_element
    languages = element.get("systemLanguage")
    spoken = languages is None or any(part.strip().split("-")[0] == LANGUAGE for part in languages.split(","))
    return "requiredExtensions" not in element.attrib and spoken


def _list_children(node: Node) -> list[Node]:
    children = list(node.iter_children())
    if _get_tag(node) == "switch":
        return [child for child in children if _get_tag(child) and _is_offered(child)][:1]
    return children


def _enter(node: Node, place: _Place, stated: dict[str, str], element: str | None) -> _Place:
    """Return the place inside an element: its transform applied, its looks over those around it."""
    gone = place.gone
    if not gone and stated.get("display", "").lower() == "none":
        gone = f"display: none of {_format_name(node)}"
    matrix = place.matrix
    for name in ("rotate", "scale"):  # properties of CSS beside its transform, applied before it
        if stated.get(name, "none").lower() != "none":
            matrix = matrix @ parse_transform(f"{name}({stated[name]})")
    if "transform" in stated:
        matrix = matrix @ parse_transform(stated["transform"])
    return replace(
        place,
        matrix=matrix,
        asked=place.asked or (element is not None and node.id == element),
        gone=gone,
        visibility=stated.get("visibility", place.visibility).lower(),
        fill=stated.get("fill", place.fill).lower(),
        stroke=stated.get("stroke", place.stroke).lower(),
    )


def _enter_viewport(node: Node, place: _Place, stated: dict[str, str]) -> _Place:
    """Return the place inside an <svg> or <symbol>: its view box laid into its size."""
    outermost = node.parent is None and not place.uses
    view = parse_view_box(node.etree_element.get("viewBox"))
    sizes = {**stated, **(place.size or {})}
    size: list[float | None] = []
    corner: list[float] = []
    for side, axis, around in zip(("width", "height"), "xy", place.box, strict=True):
        text = sizes.get(side, "auto").strip()
        if outermost and (text == "auto" or text.endswith("%")):
            size.append(None)
        else:
            size.append(around if text == "auto" else parse_length(text, around))
        corner.append(0.0 if outermost else parse_length(stated.get(axis, "0"), around))
    if view is not None and outermost:
        size = _complete_size(size, view)
    fit = node.etree_element.get("preserveAspectRatio", "xMidYMid")
    matrix = place.matrix @ make_shift(*corner) @ compute_view(Box(*size), view, fit)
    return replace(place, matrix=matrix, box=Box(*(size if view is None else view[2:])), size=None)


def _complete_size(size: list[float | None], view: list[float]) -> list[float | None]:
    """Give a drawing that states one size, or none, the other by the aspect ratio of its view box."""
    width, height = size
    if width is None and height is None:
        return [view[2], view[3]]
    if width is None:
        assert height is not None
        return [height * view[2] / view[3], height]
    return [width, width * view[3] / view[2] if height is None else height]


def _make_shape(node: Node, place: _Place, stated: dict[str, str]) -> DrawnShape:
    kind = _get_tag(node)
    hidden = place.gone
    if not hidden and place.visibility in ("hidden", "collapse"):
        hidden = f"visibility: {place.visibility}"
    return DrawnShape(
        kind=kind,
        id=node.id or "",
        data=make_path_data(kind, {**node.etree_element.attrib, **stated}, place.box),
        matrix=place.matrix,
        asked=place.asked,
        hidden=hidden,
        painted=any(paint not in ("none", "transparent") for paint in (place.fill, place.stroke)),
    )
