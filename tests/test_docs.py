"""The pages of the reference that are generated are those of the code."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "examples").glob("*.md")), *sorted(DOCS.rglob("*.md"))]


def test_reference_is_current() -> None:
    """What `python docs/generate_reference.py` would write stands there."""
    for name, text in runpy.run_path(str(DOCS / "generate_reference.py"))["pages"]().items():
        assert (DOCS / "reference" / name).read_text() == text, f"docs/reference/{name}: run docs/generate_reference.py"


def test_every_page_is_in_the_navigation() -> None:
    """No page of the site can only be found by searching, and none is named that is not there."""
    named = re.findall(r": ([\w/-]+\.md)$", (DOCS.parent / "mkdocs.yml").read_text(), flags=re.MULTILINE)
    assert len(named) == len(set(named))
    assert set(named) == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}


def test_site_asks_no_other_host() -> None:
    """Readers are not told on: fonts are those of the system, and nothing is fetched from elsewhere."""
    text = (DOCS.parent / "mkdocs.yml").read_text()
    settings = yaml.load(re.sub(r"!!python/\S+", "", text), Loader=yaml.SafeLoader)
    assert settings["theme"]["font"] is False
    assert not re.findall(r"https?://", text)
    assert "offline" not in settings["plugins"]  # it would load a script from unpkg.com


def test_every_figure_is_shown() -> None:
    """The gallery has all figures of the reproduction."""
    shown = re.findall(r"\]\(\.\./reproduction/figures/(.*?)\)", (DOCS / "reference" / "figures.md").read_text())
    figures = DOCS / "reproduction" / "figures"
    assert sorted(shown) == sorted(str(figure.relative_to(figures)) for figure in figures.rglob("*.png"))


def links(page: Path) -> list[str]:
    """Where a page's links and pictures lead; what stands in code is none."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(), flags=re.DOTALL)
    return re.findall(r"\]\(\s*([^)\s]*)[^)]*\)", text) + re.findall(r"<(https?:[^>]*)>", text)


def anchors(page: Path) -> set[str]:
    """What a link may name behind #: ids, and headings as GitHub and the site make anchors of them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = (re.sub(r"[`*]", "", one).lower() for one in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE))
    plain = {re.sub(r"[^\w\s-]", "", one).strip().replace(" ", "-") for one in headings}
    return plain | {re.sub(r"-+", "-", one) for one in plain} | set(re.findall(r"id=\"(.*?)\"", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links(page: Path) -> None:
    """Links within the repository lead somewhere, also those of pages that the site does not have.

    Whether other hosts answer is asked by `make links` alone; here their addresses need only be whole.
    """
    for link in links(page):
        parts = urlsplit(link)
        if parts.scheme:
            is_own = parts.hostname in {"127.0.0.1", "localhost"}
            assert (parts.scheme == "https" and "." in (parts.hostname or "")) or is_own, link
            continue
        target = page.parent / unquote(parts.path) if parts.path else page
        assert target.exists(), f"{link}: there is no {target}"
        if parts.fragment and target.suffix == ".md":
            assert unquote(parts.fragment) in anchors(target), f"{link}: {target.name} has no such heading"
