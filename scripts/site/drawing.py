"""Small SVG drawings: plain shapes with the classes of docs/assets/drawing.css, for files and for pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
Point = tuple[float, float]


class Drawing:
    """Shapes on a canvas; units are px."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self._shapes: list[str] = []

    def rect(self, x: float, y: float, width: float, height: float, kind: str, *, round_: float = 0) -> None:
        """Add a rectangle by its upper left corner."""
        corner = f' rx="{round_:g}"' if round_ else ""
        self._shapes.append(
            f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"{corner}/>'
        )

    def line(self, points: Iterable[Point], kind: str) -> None:
        """Add a line through points."""
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        self._shapes.append(f'<polyline class="{kind}" points="{path}"/>')

    def dot(self, x: float, y: float, kind: str, radius: float = 4) -> None:
        """Add a filled circle."""
        self._shapes.append(f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>')

    def text(self, x: float, y: float, content: str, kind: str = "", *, anchor: str = "start") -> None:
        """Add text on a base line."""
        named = f' class="{kind}"' if kind else ""
        place = f' text-anchor="{anchor}"' if anchor != "start" else ""
        self._shapes.append(f'<text{named} x="{x:.1f}" y="{y:.1f}"{place}>{escape(content)}</text>')

    def box(
        self, x: float, y: float, width: float, height: float, lines: Sequence[tuple[str, str]], kind: str = "box"
    ) -> None:
        """Add a box with centred lines of text, each with its class."""
        self.rect(x, y, width, height, kind, round_=7)
        top = y + height / 2 - 8.5 * (len(lines) - 1) + 4.5
        for number, (content, words) in enumerate(lines):
            self.text(x + width / 2, top + 17 * number, content, words, anchor="middle")

    def image(self, x: float, y: float, size: float, url: str) -> None:
        """Add a square image by its upper left corner."""
        self._shapes.append(f'<image x="{x:.1f}" y="{y:.1f}" width="{size:g}" height="{size:g}" href="{url}"/>')

    def label(self, x: float, y: float, content: str, kind: str, *, anchor: str = "start") -> None:
        """Add bold small text with a halo, for images."""
        halo = "paint-order:stroke;stroke:var(--paper);stroke-width:3px;stroke-linejoin:round"
        self._shapes.append(
            f'<text class="{kind} bold small" style="{halo}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">'
            f"{escape(content)}</text>"
        )

    def arrow(self, points: Sequence[Point], kind: str = "arrow", *, head: str = "head") -> None:
        """Add a line with an arrowhead at its end."""
        (x0, y0), (x1, y1) = points[-2:]
        length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        self.line([*points[:-1], (x1 - 6 * ux, y1 - 6 * uy)], kind)
        corners = [(x1, y1), *((x1 - 8 * ux - s * 4 * uy, y1 - 8 * uy + s * 4 * ux) for s in (1, -1))]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        self._shapes.append(f'<polygon class="{head}" points="{path}"/>')

    def svg(self) -> str:
        """Return the drawing as an SVG file."""
        style = (DOCS / "assets" / "drawing.css").read_text(encoding="utf-8")
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" class="drawn" viewBox="0 0 {self.width:g} {self.height:g}">',
                f"<style>\n{style}</style>",
                *self._shapes,
                "</svg>\n",
            ]
        )


class Axes:
    """Scale from numbers to a drawing's coordinates."""

    def __init__(self, drawing: Drawing, left: float, right: float, low: float, high: float) -> None:
        """Map `low` to the coordinate `left` and `high` to `right`."""
        self.drawing, self.left, self.right, self.low, self.high = drawing, left, right, low, high

    def __call__(self, value: float) -> float:
        """Return a number's coordinate."""
        return self.left + (value - self.low) / (self.high - self.low) * (self.right - self.left)

    def ticks(self, values: Iterable[float], top: float, bottom: float) -> None:
        """Add vertical lines with their numbers below."""
        for value in values:
            self.drawing.line([(self(value), top), (self(value), bottom)], "rule")
            self.drawing.text(self(value), bottom + 15, f"{value:g}", "soft small", anchor="middle")
