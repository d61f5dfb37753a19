"""A figure drawn once, as a bitmap and into an SVG at the same time."""

from __future__ import annotations

import io
import re
import struct
import zlib
from typing import Any, cast

import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure

COMPRESSION = 1  # of the PNG: as small as at level 2 with filters, in less than half the time
SVG_DPI = 72.0  # of matplotlib's SVG


class BothFormats(RendererBase):
    """Hands what is drawn to matplotlib's renderer of bitmaps and to that of SVG.

    The SVG counts in the bitmap's pixels; its head says how large it is in points.
    """

    def __init__(self, figure: Figure) -> None:
        super().__init__()
        width, height = (float(x) for x in figure.bbox.size)
        self._svg_text, self._scale = io.StringIO(), figure.dpi / SVG_DPI
        self._size = width, height
        self._as_image = False
        svg = cast(Any, RendererSVG)(width, height, self._svg_text, image_dpi=72, metadata={"Date": None})
        inches = figure.get_size_inches()
        self._bitmap = cast(Any, RendererAgg)(width, height, figure.dpi)
        self._vector = cast(Any, MixedModeRenderer)(figure, *inches, figure.dpi, svg)

    def png(self) -> bytes:
        """The bitmap as a PNG; after drawing."""
        pixels = np.asarray(self._bitmap.buffer_rgba())
        height, width = pixels.shape[:2]
        rows = np.zeros((height, 1 + 4 * width), np.uint8)  # each begins with its filter: none
        rows[:, 1:] = pixels.reshape(height, -1)
        dots_per_metre = round(SVG_DPI * self._scale / 0.0254)
        chunks = (
            (b"IHDR", struct.pack(">2I5B", width, height, 8, 6, 0, 0, 0)),
            (b"pHYs", struct.pack(">2IB", dots_per_metre, dots_per_metre, 1)),
            (b"IDAT", zlib.compress(rows.data, COMPRESSION)),
            (b"IEND", b""),
        )
        parts = [struct.pack(">I", len(x)) + name + x + struct.pack(">I", zlib.crc32(name + x)) for name, x in chunks]
        return b"\x89PNG\r\n\x1a\n" + b"".join(parts)

    def svg(self) -> bytes:
        """The SVG; after drawing."""
        self._vector.finalize()
        width, height = (f"{x / self._scale:g}pt" for x in self._size)
        head, rest = re.split(r'(?<=xmlns="http://www.w3.org/2000/svg")', self._svg_text.getvalue(), maxsplit=1)
        head = re.sub(r'\bwidth="[^"]*"', f'width="{width}"', re.sub(r'\bheight="[^"]*"', f'height="{height}"', head))
        return (head + rest).encode("utf-8")

    def draw_path(self, gc: Any, path: Any, transform: Any, rgbFace: Any = None) -> None:
        """A path; collections of paths come here one by one."""
        self._bitmap.draw_path(gc, path, transform, rgbFace)
        self._vector.draw_path(self._in_pixels(gc), path, transform, rgbFace)

    def draw_markers(self, gc: Any, *drawn: Any, **named: Any) -> None:
        """Marks."""
        self._bitmap.draw_markers(gc, *drawn, **named)
        self._vector.draw_markers(self._in_pixels(gc), *drawn, **named)

    def draw_text(self, gc: Any, x: float, y: float, s: str, prop: Any, angle: float, *more: Any, **named: Any) -> None:
        """A text."""
        self._bitmap.draw_text(gc, x, y, s, prop, angle, *more, **named)
        if not self._as_image:
            prop = prop.copy()
            prop.set_size(prop.get_size_in_points() * self._scale)
        self._vector.draw_text(gc, x, y, s, prop, angle, *more, **named)

    def _in_pixels(self, gc: Any) -> Any:
        """A style for the SVG, which takes widths, dashes and hatches as they are; the bitmap's are in points."""
        if self._as_image:
            return gc
        scaled = self.new_gc()
        scaled.copy_properties(gc)
        scaled.set_linewidth(gc.get_linewidth() * self._scale)
        offset, dashes = gc.get_dashes()
        if dashes is not None:
            scaled.set_dashes(offset * self._scale, np.asarray(dashes) * self._scale)
        hatch = gc.get_hatch()
        if hatch:  # of a pattern of 72 units
            scaled.set_hatch(hatch[: max(1, round(len(hatch) / self._scale))])
            if hasattr(scaled, "set_hatch_linewidth"):  # matplotlib 3.10 and later
                scaled.set_hatch_linewidth(gc.get_hatch_linewidth() * self._scale)
        return scaled

    def draw_image(self, *drawn: Any, **named: Any) -> None:
        """An image."""
        self._bitmap.draw_image(*drawn, **named)
        self._vector.draw_image(*drawn, **named)

    def start_rasterizing(self) -> None:
        """What follows is an image in the SVG."""
        self._as_image = True
        self._vector.start_rasterizing()

    def stop_rasterizing(self) -> None:
        """What follows is drawn as vectors again."""
        self._as_image = False
        self._vector.stop_rasterizing()

    def get_text_width_height_descent(self, s: str, prop: Any, ismath: Any) -> tuple[float, float, float]:
        """The size of a text in pixels."""
        size: tuple[float, float, float] = self._bitmap.get_text_width_height_descent(s, prop, ismath)
        return size

    def points_to_pixels(self, points: Any) -> Any:
        """Pixels of so many points."""
        return points * self._scale

    def get_canvas_width_height(self) -> tuple[float, float]:
        """Of the bitmap."""
        return self._size

    def flipy(self) -> bool:
        """Whether y grows downwards."""
        return True
