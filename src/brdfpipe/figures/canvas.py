"""A figure of matplotlib that a notebook shows by itself, and that is written with the same bytes each time."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from brdfpipe import store
from brdfpipe.errors import InputError

FILES = (".svg", ".png", ".pdf")
"""Suffixes of files that are written."""


class BSDFFigure(Figure):
    """As :class:`matplotlib.figure.Figure`; needs neither pyplot nor a command of the notebook to be shown."""

    def titled(self, text: str) -> BSDFFigure:
        """The figure with a title above all axes, and with its layout: computed again, it would move by fractions of a pixel."""
        self.suptitle(text, fontsize=11)
        self.draw_without_rendering()
        self.set_layout_engine("none")
        return self

    def add_scale(self, ax: Axes, low: float, high: float, label: str) -> None:
        """Add a logarithmic scale of colours beside axes."""
        self.colorbar(ScalarMappable(LogNorm(low, high), "viridis"), ax=ax, label=label, shrink=0.7)

    def save(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write the figure as SVG, PNG or PDF, by the suffix; the same figure gives the same bytes.

        Parameters
        ----------
        path : of the file; it appears whole or not at all
        options : of :meth:`matplotlib.figure.Figure.savefig`, as ``dpi``

        Raises
        ------
        InputError : another suffix.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in FILES:
            raise InputError(path, "not a format of figures", found=repr(path.suffix), accepted=", ".join(FILES))
        store.write_bytes(path, self._bytes(suffix.removeprefix("."), **options))
        return path

    def _bytes(self, format: str, **options: Any) -> bytes:
        stream = BytesIO()
        # Without date, program and random identifiers.
        metadata = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}
        metadata["pdf"] = {"CreationDate": None, "Creator": None, "Producer": None}
        with mpl.rc_context({"svg.hashsalt": "brdfpipe"}):
            self.savefig(stream, format=format, metadata=metadata[format], **{"dpi": 120} | options)
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self._bytes("png")
