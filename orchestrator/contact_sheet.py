"""A contact sheet: what a policy sees of each simulator at every severity of an axis."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw

from adapters import catalog
from adapters.contract import AdapterError
from adapters.contract import Image as Pixels
from orchestrator.beside import alone
from orchestrator.choosing import Look
from orchestrator.environments.homes import Homes
from orchestrator.looking import see
from suites.axes import SEVERITIES, Axis
from suites.vocabulary import Condition, View

LABEL_HEIGHT, LABEL_WIDTH, GAP = 16, 150, 4
PAPER, INK = (255, 255, 255), (30, 30, 30)


def looks(task: str, axis: Axis, view: View, seed: int, homes: Homes | None = None) -> list[list[Pixels]]:
    """The first images, camera by camera: of the clean episode, then at each severity.

    They are rendered in this process, or in the environment that the simulator lives in.

    Raises:
        AdapterError: The task cannot be opened, or does not support the axis.
    """
    own = catalog.find(task.partition("/")[0])
    homes = homes or Homes()
    if homes.of(own) is not None:
        return alone(_seen, own, (task, axis, view, seed), homes)
    for simulator in catalog.simulators().values():  # set before any is imported: they import each other's renderers
        for name, value in simulator.environment.items():
            os.environ.setdefault(name, value)
    return list(_seen(task, axis, view, seed))


def _seen(task: str, axis: Axis, view: View, seed: int) -> Iterator[list[Pixels]]:
    conditions = [Condition(), *(Condition(axis.name, severity + 1) for severity in range(SEVERITIES))]
    for _, seen in see(Look(task, condition, seed, view) for condition in conditions):
        if isinstance(seen, AdapterError):
            raise seen
        yield seen


def sheet(axis: Axis, rows: Sequence[tuple[str, Sequence[Sequence[Pixels]]]]) -> Image.Image:
    """One line per task, one column per severity, cameras below each other.

    Args:
        axis: Whose levels are the columns' headings.
        rows: Task and what `looks` found.
    """
    size, cameras = rows[0][1][0][0].shape[0], len(rows[0][1][0])
    width = LABEL_WIDTH + (SEVERITIES + 1) * (size + GAP)
    height = LABEL_HEIGHT + len(rows) * (cameras * size + 2 * GAP)
    page = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(page)
    for severity in range(SEVERITIES + 1):
        heading = f"{severity}: {axis.value(severity):g} {axis.unit}" if severity else "clean"
        draw.text((LABEL_WIDTH + severity * (size + GAP), 2), heading[: size // 6], fill=INK)
    for line, (task, columns) in enumerate(rows):
        top = LABEL_HEIGHT + line * (cameras * size + 2 * GAP)
        draw.text((2, top + 2), "\n".join(task.split("/")), fill=INK)
        for severity, images in enumerate(columns):
            stacked = Image.fromarray(np.concatenate(list(images), axis=0))
            page.paste(stacked, (LABEL_WIDTH + severity * (size + GAP), top))
    return page
