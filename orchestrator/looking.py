"""The first observation of an episode, without a policy, and pictures of it: what a condition does."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from adapters import catalog
from adapters.contract import AdapterError, Image, Observation, Simulation
from orchestrator.choosing import Look
from orchestrator.perturbations import perturbed
from orchestrator.perturbations.base import Perturbed
from orchestrator.video import Made, save_png
from results.media import look_path
from suites.vocabulary import Episode, Protocol


def first_observation(simulation: Simulation, look: Look) -> Observation:
    """What a policy sees and is told after the reset.

    Raises:
        AdapterError: The task does not support the axis, or the level was missed.
    """
    episode = Episode("look", "look", look.task, look.seed, Protocol(1, 1, look.view), look.condition)
    shown = perturbed(simulation, episode)
    shown.reset(look.seed, look.condition)
    seen = shown.observe()
    if isinstance(shown, Perturbed):
        shown.delivered()  # refuses a level that was missed
    return seen


def see(looks: Iterable[Look]) -> Iterator[tuple[Look, list[Image] | AdapterError]]:
    """Look after look with what was seen, or why not. A simulation is opened for neighbours of one task and view.

    Raises:
        AdapterError: A task cannot be opened.
    """
    for (task, view), own in groupby(looks, lambda look: (look.task, look.view)):
        simulation = catalog.open_simulation(task, view)
        try:
            for look in own:
                try:
                    yield look, list(first_observation(simulation, look).images.values())
                except AdapterError as error:
                    yield look, error
        finally:
            simulation.close()


def picture(looks: Sequence[Look], folder: Path) -> Iterator[Made]:
    """Keep the looks in a run folder, look by look."""
    for look, seen in see(looks):
        if isinstance(seen, AdapterError):
            yield Made(trouble=f"no picture: {look.task} under {look.condition}, seed {look.seed}: {seen}")
        else:
            path = look_path(folder, look.task, look.condition)
            save_png(path, np.concatenate(seen, axis=1))
            yield Made((path,))
