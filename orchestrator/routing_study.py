"""How well each router of a merged model infers the task, from first observations alone."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import torch

from orchestrator.sighting import first_looks
from policies.mergevla.acting import device_here
from policies.mergevla.merged_checkpoint import MergedCheckpoint, load_merged
from policies.mergevla.merged_model import MergedModel
from policies.mergevla.routing.demonstrations import FirstSightings, first_sightings
from policies.mergevla.routing.trials import Judgement, UnknownTasks, all_routers, judge, unknown_tasks
from policies.training.dataset import datasets_of
from suites.vocabulary import RenderProfile, View

Listener = Callable[[str, int, int], None]
"""Told what is being done, and how much of how much of it is done."""


@dataclass(frozen=True)
class Order:
    """What to study."""

    checkpoint: str
    """Folder or hub id of a merged checkpoint."""
    seeds: Sequence[int]
    """Of the episodes to look at, under the clean condition; never training's."""
    keep: Path | None = None
    """Folder to keep first observations in, or to find them in."""
    demonstrations: tuple[Path, ...] = ()
    """Datasets, or folders of them, to leave tasks out of."""


@dataclass(frozen=True)
class RoutingStudy:
    """What came of it."""

    order: Order
    digest: str
    """Of the merged model."""
    view: View
    tasks: tuple[str, ...]
    """Those that were looked at."""
    skipped: dict[str, str]
    """Simulator that is not installed here, to the reason."""
    unfitted: bool
    """True if the checkpoint holds no fitted routers."""
    judgement: Judgement
    unknown: tuple[UnknownTasks, ...]
    """Empty without demonstrations."""


def study_routing(order: Order, listener: Listener) -> RoutingStudy:
    """Look at the model's tasks and put every router to the test, on one thread, as a policy does in a worker.

    Raises:
        PolicyError: The checkpoint or the demonstrations cannot be used.
        SightingError: Tasks that cannot be looked at.
        OSError: The folder to keep observations in cannot be written.
    """
    torch.set_num_threads(1)
    checkpoint = load_merged(order.checkpoint)
    card, routers = checkpoint.card, all_routers(checkpoint.fitted)
    # Before anything that takes long, so that a mistake shows at once.
    fitted_to = _fitted_to(checkpoint, order.demonstrations)
    view = View(card.architecture.cameras, card.architecture.image_size, RenderProfile.FAST)
    with ExitStack() as stack:
        folder = order.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        seen = first_looks(card.experts, view, order.seeds, folder, listener)
    sightings = {task: looks.sightings(order.seeds) for task, looks in seen.looks.items()}
    model = MergedModel(checkpoint.parts, device=device_here())
    judgement = judge(
        routers,
        model,
        [sighting for own in sightings.values() for sighting in own],
        listener=lambda done, wanted: listener("routing", done, wanted),
    )
    found: list[UnknownTasks] = []
    if fitted_to:
        found = unknown_tasks(model, fitted_to, sightings, listener=lambda *done: listener("leaving tasks out", *done))
    return RoutingStudy(
        order, card.digest, view, tuple(sightings), seen.skipped, not checkpoint.fitted, judgement, tuple(found)
    )


def _fitted_to(checkpoint: MergedCheckpoint, folders: Sequence[Path]) -> FirstSightings | None:
    if not folders:
        return None
    return first_sightings(datasets_of(folders, checkpoint.card.experts), checkpoint.parts.architecture.cameras)
