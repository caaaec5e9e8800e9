"""The pictures: one module an idea, one style for all, drawn from stored rows and arrays alone.

:mod:`bench.figures.command` is ``python -m bench.figures``; :mod:`bench.figures.gallery` reads the store, and
:mod:`bench.figures.style` says what every method looks like everywhere.
"""

from bench.figures.command import PICTURES, main
from bench.figures.style import STYLES, pyplot, save_figure

__all__ = ["PICTURES", "STYLES", "main", "pyplot", "save_figure"]
