"""Contact sheets: the first images of a task at every severity of an axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Image as Pixels
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.first_observation import Snapshot, first_observation
from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_in_simulator_environment
from robogauntlet.suites.axes import SEVERITIES, Axis
from robogauntlet.suites.episode import Condition, View

TOP, LABEL_WIDTH, GAP = 52, 160, 4
"""Height of title and headings, width of the tasks' names, and space between images (px)."""
TITLE_SIZE, TEXT_SIZE, SMALLEST_SIZE = 18, 14, 8
"""Sizes of the font (px)."""
PAPER, INK, SOFT = (255, 255, 255), (28, 35, 40), (91, 103, 112)


def render_severities(
    task: str, axis: Axis, view: View, seed: int, environments: EnvironmentResolver | None = None
) -> list[list[Pixels]]:
    """Render the first images of all cameras, of the clean episode and then at each severity.

    Raises:
        AdapterError: The task cannot be opened, or does not support the axis.
    """
    simulator, arguments = catalog.find(task.partition("/")[0]), (task, axis, view, seed)
    return run_in_simulator_environment(_first_images, simulator, arguments, environments or EnvironmentResolver())


def _first_images(task: str, axis: Axis, view: View, seed: int) -> Iterator[list[Pixels]]:
    conditions = [Condition(), *(Condition(axis.name, severity + 1) for severity in range(SEVERITIES))]
    simulation = catalog.open_simulation(task, view)
    try:
        for condition in conditions:
            yield list(first_observation(simulation, Snapshot(task, condition, seed, view)).images.values())
    finally:
        simulation.close()


def draw_contact_sheet(axis: Axis, rows: Sequence[tuple[str, Sequence[Sequence[Pixels]]]]) -> Image.Image:
    """Draw a row per task, from `render_severities`, and a column per severity, with the cameras below each other.

    The title is the axis with its unit; a column is headed by its severity and the level of that.
    """
    size, cameras = rows[0][1][0][0].shape[0], len(rows[0][1][0])
    width = LABEL_WIDTH + (SEVERITIES + 1) * (size + GAP)
    height = TOP + len(rows) * (cameras * size + 2 * GAP)
    page = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(page)
    _write(draw, (GAP, GAP), f"{axis.name} ({axis.unit})", TITLE_SIZE, width - 2 * GAP)
    for severity in range(SEVERITIES + 1):
        heading = f"{severity}: {axis.value(severity):g}" if severity else "clean"
        _write(draw, (LABEL_WIDTH + severity * (size + GAP), TOP - 20), heading, TEXT_SIZE, size)
    for line, (task, columns) in enumerate(rows):
        top = TOP + line * (cameras * size + 2 * GAP)
        simulator, _, name = task.partition("/")
        _write(draw, (GAP, top), name, TEXT_SIZE, LABEL_WIDTH - 3 * GAP)
        _write(draw, (GAP, top + 18), simulator, TEXT_SIZE, LABEL_WIDTH - 3 * GAP, SOFT)
        for severity, images in enumerate(columns):
            stacked = Image.fromarray(np.concatenate(list(images), axis=0))
            page.paste(stacked, (LABEL_WIDTH + severity * (size + GAP), top))
    return page


def _write(
    draw: ImageDraw.ImageDraw,
    place: tuple[int, int],
    text: str,
    size: int,
    width: int,
    colour: tuple[int, int, int] = INK,
) -> None:
    """Write a line in the largest font up to `size` in which it is at most `width` wide (px)."""
    fonts = (ImageFont.load_default(pixels) for pixels in range(size, SMALLEST_SIZE - 1, -1))
    font = next((font for font in fonts if font.getlength(text) <= width), ImageFont.load_default(SMALLEST_SIZE))
    draw.text(place, text, fill=colour, font=font)
