"""Small pictures of curves and maps, by Pillow: drawn in a few milliseconds while a run goes on.

Shapes: `P` points of a curve, `Y` and `X` rows and columns of a map.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

ZONE_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Vermillion, blue, bluish green, reddish purple, orange, sky blue: zone after zone."""

MIXED_COLOUR = "#999999"
"""For regions that cover no zone well enough."""

SIZE = (330, 212)
"""Width and height of a picture (pixels): TensorBoard's cards have so much room, and make larger
ones smaller by leaving out pixels."""

MARGINS = (40, 32, 62, 34)
"""Pixels to the left of the axes, above them, to the right and below."""

FINER = 2
"""Pictures are drawn so many times as large and then made smaller, which smooths lines."""

FONT_SIZE = 11
"""Height of letters (pixels)."""

LEAST_GAP = 12
"""Labels at the right are so many pixels apart; those in between are left out."""

GOOD, NEUTRAL, BAD = "#0072B2", "#FFFFFF", "#D55E00"
"""Colours of the best, of no and of the worst progress: blue, white, vermillion."""

GRID, FRAME = "#E4E4E4", "#888888"
"""Colours of lines behind the curves and of the axes."""


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes:
        low: The number at its beginning.
        high: The number at its end, above `low`.
        label: What the numbers are.
    """

    low: float
    high: float
    label: str

    def place(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where values, of any shape, lie: from 0 at the beginning to 1 at the end."""
        return np.asarray((values - self.low) / (self.high - self.low))

    def ticks(self) -> list[float]:
        """Return two to five round numbers on the axis."""
        rough = (self.high - self.low) / 4
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(power * of for of in (1, 2, 5, 10) if power * of >= rough * (1 - 1e-9))
        first = math.ceil(self.low / step - 1e-9)
        return [n * step for n in range(first, math.floor(self.high / step + 1e-9) + 1)]


class Chart:
    """A picture with two axes, drawn step by step.

    Args:
        across: The horizontal axis.
        up: The vertical axis.
        has_grid: Whether the ticks of the vertical axis are drawn, with a grid.
    """

    def __init__(self, across: Axis, up: Axis, has_grid: bool = True) -> None:
        self._across, self._up = across, up
        left, top, right, bottom = MARGINS
        self.left, self.top = left, top
        self.right, self.bottom = SIZE[0] - right, SIZE[1] - bottom
        self._picture = Image.new("RGB", (SIZE[0] * FINER, SIZE[1] * FINER), "white")
        self._pen = ImageDraw.Draw(self._picture)
        self._font = ImageFont.load_default(FONT_SIZE * FINER)
        if has_grid:
            for tick in up.ticks():
                y = self._y(np.array([tick]))[0]
                self._draw_line([(self.left, y), (self.right, y)], GRID)
                self.write(self.left - 6, y, f"{tick:.4g}", "rm")
        for tick in across.ticks():
            x = self._x(np.array([tick]))[0]
            self._draw_line([(x, self.bottom), (x, self.bottom + 4)], FRAME)
            self.write(x, self.bottom + 5, f"{tick:,.6g}", "ma")
        self._draw_line([(self.left, self.bottom), (self.right, self.bottom)], FRAME)
        self.write(self.right, SIZE[1] - 3, across.label, "rd")
        self.write(4, 4, up.label, "la")

    def line(
        self,
        xs: NDArray[np.float64],
        ys: NDArray[np.float64],
        colour: str,
        width: float = 1.5,
    ) -> None:
        """Draw a curve, shape `(P,)` each; NaN is left out."""
        known = np.isfinite(ys)
        points = np.stack([self._x(xs[known]), self._y(ys[known])], axis=-1)
        self._draw_line(points.tolist(), colour, width)

    def paint(self, colours: NDArray[np.uint8], left: float = 0.0, right: float = 1.0) -> None:
        """Fill the axes with a map, shape `(Y, X, 3)`, its first row at the bottom.

        Args:
            colours: Red, green and blue of each cell.
            left: Where it begins, as a share of the axes' width.
            right: Where it ends; beyond 1 is to the right of the axes.
        """
        width = self.right - self.left
        start, end = (round((self.left + share * width) * FINER) for share in (left, right))
        size = (end - start, (self.bottom - self.top) * FINER)
        cells = Image.fromarray(np.ascontiguousarray(colours[::-1]))
        cells = cells.resize(size, Image.Resampling.NEAREST)
        self._picture.paste(cells, (start, self.top * FINER))

    def key(self, colours: Mapping[str, str]) -> None:
        """Say what some colours are, above the axes at the right."""
        x = float(self.right + MARGINS[2] - 6)
        for name, colour in reversed(list(colours.items())):
            self.write(x, 4, name, "ra", colour)
            x -= self._pen.textlength(name, self._font) / FINER + 12

    def notes(self, texts: Sequence[str], ys: Sequence[float], colours: Sequence[str]) -> None:
        """Write texts at the right of the axes, at heights between 0 and 1, where there is room.

        The first go first.
        """
        taken: list[float] = []
        for text, height, colour in zip(texts, ys, colours, strict=True):
            y = self.bottom - height * (self.bottom - self.top)
            if all(abs(y - other) >= LEAST_GAP for other in taken):
                self.write(self.right + 6, y, text, "lm", colour)
                taken.append(y)

    def write(self, x: float, y: float, text: str, anchor: str, colour: str = "black") -> None:
        """Write a text at a place of the picture (pixels); `anchor` is Pillow's."""
        self._pen.text((x * FINER, y * FINER), text, colour, self._font, anchor)

    def scale(self, colours: NDArray[np.uint8], low: str, high: str) -> None:
        """Draw a scale of colours, shape `(X, 3)`, above the axes, with what its ends mean."""
        x, y, size = SIZE[0] / 2 - 30, self.top - 14, (60, 8)
        bar = Image.fromarray(colours[None]).resize((size[0] * FINER, size[1] * FINER))
        self._picture.paste(bar, (round(x * FINER), y * FINER))
        self.write(x - 6, y + size[1] / 2, low, "rm")
        self.write(x + size[0] + 6, y + size[1] / 2, high, "lm")

    def picture(self) -> Image.Image:
        """Return it, `SIZE` large."""
        return self._picture.reduce(FINER)

    def _x(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.left + self._across.place(values) * (self.right - self.left))

    def _y(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.bottom - self._up.place(values) * (self.bottom - self.top))

    def _draw_line(
        self, points: Sequence[Sequence[float]], colour: str, width: float = 1.0
    ) -> None:
        fine = [(x * FINER, y * FINER) for x, y in points]
        self._pen.line(fine, colour, max(1, round(width * FINER)))


def shades(progress: NDArray[np.float64], scale: float) -> NDArray[np.uint8]:
    """Return the colours of learning progress, shape `(..., 3)`.

    Args:
        progress: Any shape; NaN is white.
        scale: The progress that has the strongest colour, above 0.
    """
    bad, neutral, good = (np.array(ImageColor.getrgb(of), float) for of in (BAD, NEUTRAL, GOOD))
    strength = np.clip(np.nan_to_num(progress) / scale, -1, 1)[..., None]
    mixed = neutral + np.abs(strength) * (np.where(strength > 0, good, bad) - neutral)
    return np.asarray(np.round(mixed).astype(np.uint8))


def zone_colour(zone: int) -> str:
    """Return the colour of a zone; that of mixed regions for a negative one."""
    return ZONE_COLOURS[zone % len(ZONE_COLOURS)] if zone >= 0 else MIXED_COLOUR
