"""The pages of the reference that are generated are those of the code."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import yaml

DOCS = Path(__file__).parent.parent / "docs"


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
