"""The picture of a check: the images as the policy gets them, and its actions beside the simulation's limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Image as Pixels
from robogauntlet.orchestrator.kit.policy.motion import Movement, describe

HEADING_HEIGHT, LABEL_WIDTH, GAP = 24, 160, 4
"""Height of headings, width of labels, and space between images (px)."""
TEXT_SIZE, SMALLEST_SIZE = 14, 8
"""Sizes of the font (px)."""
PAPER, INK = (255, 255, 255), (28, 35, 40)
CHART_WIDTH, CHART_HEIGHT, TEXT_WIDTH, MARGIN = 360, 46, 430, 10
LINE, BOUND, ZERO = (31, 90, 170), (200, 60, 50), (205, 205, 205)
SMALLEST = 192
"""Images are enlarged to about this height (px), each pixel to a square."""


def draw_picture(
    images: Sequence[tuple[str, Mapping[str, Pixels]]],
    actions: FloatArray,
    spec: ActionSpec,
    moves: Sequence[Movement],
    title: str,
) -> Pixels:
    """Draw the picture.

    Args:
        images: Label and images by name, of some queries.
        actions: Executed actions, shape (steps, numbers of an action).
        spec: The simulation's limits.
        moves: What the numbers do alone.
        title: Its first line.

    Returns:
        Shape (height, width, 3).
    """
    names = list(images[0][1]) if images else []
    charts = _charts(actions, spec, {move.name: describe(move) for move in moves})
    parts = [_text_line(title), charts]
    if images:
        rows = [(label, [_enlarged(shown[name]) for name in names]) for label, shown in images]
        parts.insert(1, _grid(names, rows))
    page = Image.new("RGB", (max(part.width for part in parts), sum(part.height for part in parts)), PAPER)
    top = 0
    for part in parts:
        page.paste(part, (0, top))
        top += part.height
    return np.asarray(page)


def _text_line(text: str) -> Image.Image:
    line = Image.new("RGB", (LABEL_WIDTH + CHART_WIDTH + TEXT_WIDTH, 24), PAPER)
    ImageDraw.Draw(line).text((2, 4), text, fill=INK, font=_font(13))
    return line


def _font(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


def _enlarged(image: Pixels) -> Pixels:
    factor = max(1, SMALLEST // image.shape[0])
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def _charts(actions: FloatArray, spec: ActionSpec, effects: Mapping[str, str]) -> Image.Image:
    font = _font(11)
    told = {"gripper": "-1 opens, +1 closes"} | dict.fromkeys(spec.ignored, "ignored by this task") | dict(effects)
    ranges = zip(spec.names, actions.min(axis=0), actions.max(axis=0), strict=True)
    labels = [f"{name}  {low:.3g} to {high:.3g}" for name, low, high in ranges]
    left, right = (max(map(font.getlength, texts), default=0.0) for texts in (labels, told.values()))
    left, right = max(LABEL_WIDTH, math.ceil(left) + 10), max(TEXT_WIDTH, math.ceil(right) + 16)
    page = Image.new("RGB", (left + CHART_WIDTH + right, len(spec.names) * CHART_HEIGHT + 2 * MARGIN), PAPER)
    draw = ImageDraw.Draw(page)
    for index, (name, label) in enumerate(zip(spec.names, labels, strict=True)):
        values, bounds = (
            actions[:, index],
            [bound for bound in (*spec.low[[index]], *spec.high[[index]]) if abs(bound) < np.inf],
        )
        top = MARGIN + index * CHART_HEIGHT
        middle, half = top + CHART_HEIGHT / 2, CHART_HEIGHT / 2 - 5
        scale = half / (max(float(np.abs(values).max()), *map(abs, bounds)) or 1.0)
        draw.text((2, middle - 8), label, fill=INK, font=font)
        draw.line([(left, middle), (left + CHART_WIDTH, middle)], fill=ZERO)
        for bound in bounds:
            draw.line([(left, middle - bound * scale), (left + CHART_WIDTH, middle - bound * scale)], BOUND)
        points = [
            (left + CHART_WIDTH * (step + side) / len(values), middle - float(value) * scale)
            for step, value in enumerate(values)
            for side in (0, 1)
        ]
        draw.line(points, fill=LINE, width=2)
        draw.text((left + CHART_WIDTH + 8, middle - 8), told.get(name, ""), fill=INK, font=font)
    return page


def _grid(headings: Sequence[str], rows: Sequence[tuple[str, Sequence[Pixels]]]) -> Image.Image:
    """Draw labelled rows of images, a column per heading."""
    shapes = [image.shape for _, columns in rows for image in columns]
    width, height = max(shape[1] for shape in shapes), max(shape[0] for shape in shapes)
    size = LABEL_WIDTH + len(headings) * (width + GAP), HEADING_HEIGHT + len(rows) * (height + 2 * GAP)
    page = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    for column, heading in enumerate(headings):
        _write_fitting(draw, (LABEL_WIDTH + column * (width + GAP), GAP), heading, width)
    top = HEADING_HEIGHT
    for label, columns in rows:
        _write_fitting(draw, (GAP, top), label, LABEL_WIDTH - 3 * GAP)
        for column, image in enumerate(columns):
            page.paste(Image.fromarray(image), (LABEL_WIDTH + column * (width + GAP), top))
        top += height + 2 * GAP
    return page


def _write_fitting(draw: ImageDraw.ImageDraw, place: tuple[int, int], text: str, width: int) -> None:
    """Write a line in the largest font in which it is at most `width` wide (px)."""
    fonts = (ImageFont.load_default(pixels) for pixels in range(TEXT_SIZE, SMALLEST_SIZE - 1, -1))
    font = next((font for font in fonts if font.getlength(text) <= width), ImageFont.load_default(SMALLEST_SIZE))
    draw.text(place, text, fill=INK, font=font)
