"""Galleries: figures that need no runs."""

from __future__ import annotations

from typing import Any

from jobs.analysis.plotting import style
from jobs.experiment.figures import Picture
from jobs.experiment.spec import Gallery
from jobs.reproduction.maze_pictures import draw_mazes
from jobs.reproduction.theory_pictures import draw_adaptation, draw_design, draw_growth
from jobs.results.storage import Folder

_OF_THEORY = {"growth": draw_growth, "adaptation": draw_adaptation, "design": draw_design}


def draw_gallery(gallery: Gallery, folder: Folder) -> list[str]:
    """Draw the pictures of a gallery into a folder; returns where the files are."""
    written = []
    for picture in gallery.pictures:
        with style.pyplot() as plt:
            written += style.save(folder, _draw(plt, picture, gallery), picture.name)
    return written


def _draw(plt: Any, picture: Picture, gallery: Gallery) -> Any:
    if picture.kind == "mazes":
        return draw_mazes(plt, picture, gallery)
    return _OF_THEORY[picture.kind](plt, picture)
