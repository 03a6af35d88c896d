"""Figures that need no runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from jobs.experiment.figures import Picture
from jobs.experiment.spec import Gallery
from jobs.experiment.spec_files import shipped_galleries
from jobs.reproduction.gallery import draw_gallery
from jobs.results.storage import Folder
from tests.jobs.analysis.plotting.test_figures import pictures


def test_galleries_are_drawn(tmp_path: Path) -> None:
    """Every picture that ships, and the same again."""
    galleries = shipped_galleries().values()
    first = [pictures(draw_gallery(gallery, Folder(str(tmp_path)))) for gallery in galleries]
    assert {name for drawn in first for name in drawn if name.endswith("png")} == {
        f"{picture.name}.png" for gallery in galleries for picture in gallery.pictures
    }
    theory: Gallery = shipped_galleries()["theory"]
    growth = theory.model_copy(update={"pictures": theory.pictures[:1]})
    again = pictures(draw_gallery(growth, Folder(str(tmp_path))))
    assert any(again.items() <= drawn.items() for drawn in first)


def test_probabilities_are_of_a_named_decay() -> None:
    """Of the design there are none."""
    Picture(kind="design", name="one", decays=[0.1])
    with pytest.raises(ValidationError, match="growth: found no shown_decay"):
        Picture(kind="growth", name="one", decays=[0.1])
