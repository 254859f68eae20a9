"""Contact sheets: the first images of a task at every severity of an axis."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Image as Pixels
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_in_simulator_environment
from robogauntlet.orchestrator.replay.first_observation import first_observation
from robogauntlet.orchestrator.replay.media_selection import Snapshot
from robogauntlet.suites.axes import SEVERITIES, Axis
from robogauntlet.suites.episode import Condition, View

TITLE_HEIGHT, HEADING_HEIGHT, LABEL_WIDTH, GAP = 28, 24, 160, 4
"""Heights of title and headings, width of the labels, and space between images (px)."""
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
    headings = ["clean", *(f"{severity}: {axis.value(severity):g}" for severity in range(1, SEVERITIES + 1))]
    stacked = [(task, [np.concatenate(list(images), axis=0) for images in columns]) for task, columns in rows]
    return draw_grid(headings, stacked, f"{axis.name} ({axis.unit})")


def as_png(page: Image.Image) -> bytes:
    """Return the content of a PNG file that says at its beginning which software wrote it."""
    software = PngInfo()
    software.add_text("Software", "RoboGauntlet")
    content = io.BytesIO()
    page.save(content, "png", pnginfo=software)
    return content.getvalue()


def draw_grid(
    headings: Sequence[str], rows: Sequence[tuple[str, Sequence[Pixels]]], title: str | None = None
) -> Image.Image:
    """Draw labelled rows of images, a column per heading. The part of a label before a slash is below the rest."""
    shapes = [image.shape for _, columns in rows for image in columns]
    width, height = max(shape[1] for shape in shapes), max(shape[0] for shape in shapes)
    top = TITLE_HEIGHT if title is not None else 0
    size = LABEL_WIDTH + len(headings) * (width + GAP), top + HEADING_HEIGHT + len(rows) * (height + 2 * GAP)
    page = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    if title is not None:
        write_fitting(draw, (GAP, GAP), title, TITLE_SIZE, size[0] - 2 * GAP)
    for column, heading in enumerate(headings):
        write_fitting(draw, (LABEL_WIDTH + column * (width + GAP), top + GAP), heading, TEXT_SIZE, width)
    top += HEADING_HEIGHT
    for label, columns in rows:
        simulator, _, name = label.rpartition("/")
        write_fitting(draw, (GAP, top), name, TEXT_SIZE, LABEL_WIDTH - 3 * GAP)
        write_fitting(draw, (GAP, top + 18), simulator, TEXT_SIZE, LABEL_WIDTH - 3 * GAP, SOFT)
        for column, image in enumerate(columns):
            page.paste(Image.fromarray(image), (LABEL_WIDTH + column * (width + GAP), top))
        top += height + 2 * GAP
    return page


def write_fitting(
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
