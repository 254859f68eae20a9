"""The picture of a check: the images as the policy gets them, and its actions beside the simulation's limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from robogauntlet.adapters.contract import ActionSpec, FloatArray
from robogauntlet.adapters.contract import Image as Pixels
from robogauntlet.orchestrator.policy_kit.motion import Movement, describe
from robogauntlet.orchestrator.replay.contact_sheet import INK, LABEL_WIDTH, PAPER, draw_grid

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
    told = {move.name: f"{move.value:+.2g} {describe(move)}" for move in moves}
    needed = [math.ceil(_font(11).getlength(text)) + 16 for text in told.values()]
    width = LABEL_WIDTH + CHART_WIDTH + max([TEXT_WIDTH, *needed])
    charts = Image.new("RGB", (width, len(spec.names) * CHART_HEIGHT + 2 * MARGIN), PAPER)
    _draw_charts(charts, actions, spec, told)
    parts = [_text_line(title), charts]
    if images:
        rows = [(label, [_enlarged(shown[name]) for name in names]) for label, shown in images]
        parts.insert(1, draw_grid(names, rows))
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


def _draw_charts(page: Image.Image, actions: FloatArray, spec: ActionSpec, words: Mapping[str, str]) -> None:
    draw = ImageDraw.Draw(page)
    for index, name in enumerate(spec.names):
        values, bounds = actions[:, index], (float(spec.low[index]), float(spec.high[index]))
        top = MARGIN + index * CHART_HEIGHT
        middle, half = top + CHART_HEIGHT / 2, CHART_HEIGHT / 2 - 5
        scale = half / (max(float(np.abs(values).max()), *map(abs, bounds)) or 1.0)
        draw.text((2, middle - 8), f"{name}  {values.min():.3g} to {values.max():.3g}", fill=INK, font=_font(11))
        draw.line([(LABEL_WIDTH, middle), (LABEL_WIDTH + CHART_WIDTH, middle)], fill=ZERO)
        for bound in bounds:
            draw.line(
                [(LABEL_WIDTH, middle - bound * scale), (LABEL_WIDTH + CHART_WIDTH, middle - bound * scale)], BOUND
            )
        points = [
            (LABEL_WIDTH + CHART_WIDTH * (step + side) / len(values), middle - float(value) * scale)
            for step, value in enumerate(values)
            for side in (0, 1)
        ]
        draw.line(points, fill=LINE, width=2)
        told = words.get(name, "ignored by this task" if name in spec.ignored else "")
        if name == "gripper" and not told:
            told = "-1 opens, +1 closes"
        draw.text((LABEL_WIDTH + CHART_WIDTH + 8, middle - 8), told, fill=INK, font=_font(11))
