"""What a visitor of the repository meets: pages that read where they lie, links that work, the checks of CI."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")
FENCED = re.compile(r"^(`{3,}).*?^\1$", re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Names that a link to a part of a page may have: of its headings, and of places that are marked."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)"', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_reads_where_it_lies_and_its_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"^(?:`{3,}|:{3,})\{.*$|^\([\w-]+\)=$|\{[a-z]+\}`", text, re.MULTILINE)
    for link in LINK.findall(FENCED.sub("", text)):
        name, _, part = link.partition("#")
        if re.match(r"[a-z]+:", name):
            continue
        target = page if not name else page.parent / name
        assert target.exists(), f"{link} leads nowhere"
        assert not part or part in anchors(target), f"{link}: no such heading"


def test_commits_are_checked_by_what_ci_checks():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    lint = re.search(r"^ *make (lint.*)$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    assert lint is not None
    assert [hook["entry"] for hook in hooks] == [f"make {target}" for target in lint[1].split()]


def test_the_citation_is_of_this_version_and_names_the_paper():
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (found["version"], found["license"]) == (project["version"], project["license"])
    assert {"cff-version", "message", "title", "authors"} <= set(found)
    assert found["references"][0]["doi"] == "10.1038/s44182-024-00008-x"
