"""Contact sheets: the first images of a task at every severity of an axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Image as Pixels
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.first_observation import Snapshot, first_observation
from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_in_simulator_environment
from robogauntlet.suites.axes import SEVERITIES, Axis
from robogauntlet.suites.episode import Condition, View

LABEL_HEIGHT, LABEL_WIDTH, GAP = 16, 150, 4
PAPER, INK = (255, 255, 255), (30, 30, 30)


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
    """Draw a row per task, from `render_severities`, and a column per severity, with the cameras below each other."""
    headings = ["clean"]
    headings += [f"{severity}: {axis.value(severity):g} {axis.unit}" for severity in range(1, SEVERITIES + 1)]
    stacked = [(task, [np.concatenate(list(images), axis=0) for images in columns]) for task, columns in rows]
    return draw_grid(headings, stacked)


def draw_grid(headings: Sequence[str], rows: Sequence[tuple[str, Sequence[Pixels]]]) -> Image.Image:
    """Draw labelled rows of images, a column per heading. A slash in a label breaks the line."""
    images = [image for _, columns in rows for image in columns]
    width, height = max(image.shape[1] for image in images), max(image.shape[0] for image in images)
    size = LABEL_WIDTH + len(headings) * (width + GAP), LABEL_HEIGHT + len(rows) * (height + 2 * GAP)
    page = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    for column, heading in enumerate(headings):
        draw.text((LABEL_WIDTH + column * (width + GAP), 2), heading[: width // 6], fill=INK)
    for line, (label, columns) in enumerate(rows):
        top = LABEL_HEIGHT + line * (height + 2 * GAP)
        draw.text((2, top + 2), "\n".join(label.split("/")), fill=INK)
        for column, image in enumerate(columns):
            page.paste(Image.fromarray(image), (LABEL_WIDTH + column * (width + GAP), top))
    return page
