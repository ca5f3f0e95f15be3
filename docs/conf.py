"""Sphinx configuration: `make docs`. Needs no network, neither to build the pages nor to read them."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

import lookup_tables.builder  # noqa: E402
import smolbot  # noqa: E402

# Imported there for type checkers only, without which the types of its signatures cannot be resolved.
lookup_tables.builder.FieldTable = lookup_tables.FieldTable  # type: ignore[misc]

project = "smolbot"
author = "The smolbot developers"
project_copyright = "The smolbot developers"
version = release = smolbot.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "mathml",
    "filekeys",
    "sphinx_external_toc",
]
suppress_warnings = ["etoc.toctree"]  # the API reference lists its own pages
exclude_patterns = ["_build", "README.md"]
templates_path = ["_templates"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
numfig = False
math_number_all = False
html_math_renderer = "mathml"

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
numpydoc_show_class_members = False

nitpicky = True
# Names of other projects, which a build without a network cannot look up. Names of our own must be found.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|npt|collections|pathlib|Path|os|typing|concurrent|dict\[str)(\..*)?"),
    (r"py:class", r"smolbot\.runs\.recording\.run_pb2\..*"),  # described by run.proto
    (r"py:class", r"smolbot\.config\.document\.Model"),  # a type variable
    (r"py:class", r"(sim\.(tank|reduced)\.rig\.)?(TankRig|TankStage|ReducedRig)"),  # keep the protocol Rig
    # parts of the loop, which are handed in and not made by hand
    (r"py:class", r"smolbot\.flight\.(loop|pause|preparation|safety|scheduler|tracking\.channel_watch)\..*"),
    (r"py:class", r"smolbot\.paths\.visits\.Visits"),  # between summary and verdict
    (r"py:class", r"smolbot\.(localization\.(array|synthetic)|runs\.(folder|recording\.message_queue))\..*"),
]

smartquotes = False

html_theme = "furo"
html_title = "smolbot"
html_static_path = ["_static"]
html_css_files = ["smolbot.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}

_ARRAY = re.compile(r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.(float64|bool)_?\]\]")
_NAMES = {"float64": "FloatArray", "bool": "BoolArray"}


def _name_arrays(app: Any, what: str, name: str, obj: Any, options: Any, signature: str, returns: str) -> Any:
    """Arrays by the names that the code has for them."""
    return tuple(
        None if text is None else _ARRAY.sub(lambda found: f"~smolbot.core.{_NAMES[found[1]]}", text)
        for text in (signature, returns)
    )


def setup(app: Any) -> None:
    """Register what this file defines in Sphinx.

    Parameters
    ----------
    app : Sphinx
    """
    app.connect("autodoc-process-signature", _name_arrays)
