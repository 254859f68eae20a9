"""Whether our router still finds the task when the world changes: first observations under each axis, nothing played.

Not a speed. Fitted to demonstrations in four ways, the shipped one last; see `scripts/zoo.sh` for the folder.
`DEMONSTRATIONS=FOLDER python -m tests.benchmarks shifted_routing`
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.contract import AdapterError
from orchestrator.choosing import Look
from orchestrator.looking import first_observation
from suites.vocabulary import CLEAN, Condition, RenderProfile, View
from tests.benchmarks.shared import open_task, table

if TYPE_CHECKING:
    from policies.mergevla.merged_model import MergedModel
    from policies.mergevla.routing.contract import Sighting
    from policies.mergevla.routing.demonstrations import FirstSightings
    from policies.mergevla.routing.features import Reading

SEEDS = range(2_000_000, 2_000_012)
"""Neither training's (from 1,000,000) nor those of the reports (from 0)."""
LEVELS = dict.fromkeys(
    (
        "camera-orbit",
        "camera-distance",
        "field-of-view",
        "camera-bump",
        "illuminance",
        "light-direction",
        "colour-temperature",
        "table",
        "distractors",
        "object-position",
        "robot-start",
        "noise",
        "blur",
    ),
    (2, 4),
) | {"instruction": (1, 2, 3, 4, 5)}
"""Severities of the axes that change what is seen or said first."""
AS_THEY_COME, VARIED = "as they come", "varied"
AUROC = "AUROC of unknown tasks, clean"


def measure() -> list[dict[str, object]]:
    """Accuracy by axis, pooled over tasks and severities, and what is unknown, for each way of reading and fitting."""
    import torch

    from policies.mergevla.merged_checkpoint import load_merged
    from policies.mergevla.merged_model import MergedModel
    from policies.mergevla.routing.catalog import reading_of
    from policies.mergevla.routing.demonstrations import first_sightings
    from policies.mergevla.routing.features import Reading
    from policies.training.dataset import datasets_of

    torch.set_num_threads(1)
    model = MergedModel(load_merged("zoo:merged").parts)
    view = View(model.architecture.cameras, model.architecture.image_size, RenderProfile.FAST)
    folder = Path(os.environ.get("DEMONSTRATIONS", "runs/zoo/demonstrations"))
    first = first_sightings(datasets_of([folder], model.experts), view.cameras)
    seen = dict(_looks(model.experts, view))
    rows = []
    for sees in (True, False):
        ways = {
            f"{frames}, {layer}": _judged(model, first, seen, reading, varies=frames == VARIED)
            for frames in (AS_THEY_COME, VARIED)
            for layer, reading in (
                ("last", Reading(sees)),
                ("middle", reading_of(model.architecture, sees_instruction=sees)),
            )
        }
        print(f"\nInstruction {'read' if sees else 'hidden'}, {sum(map(len, seen.values()))} first observations")
        names = next(iter(ways.values()))
        shares = [(name, *(f"{100 * own[name]:.1f} %" for own in ways.values())) for name in names if name != AUROC]
        table(("", *ways), [*shares, (AUROC, *(f"{own[AUROC]:.3f}" for own in ways.values()))])
        rows += [{"sees_instruction": sees, "way": way, **own} for way, own in ways.items()]
    return rows


def _looks(tasks: Sequence[str], view: View) -> Iterator[tuple[tuple[str, str], list[Sighting]]]:
    """First observations of each task along each axis; what a task cannot have is left out."""
    from policies.mergevla.routing.keeping import FirstLooks

    for task in tasks:
        simulation = open_task(task, view)
        for axis, severities in {CLEAN: (0,), **LEVELS}.items():
            found: list[Sighting] = []
            for severity in severities:
                for seed in SEEDS:
                    look = Look(task, Condition(axis, severity), seed, view)
                    with contextlib.suppress(AdapterError):
                        observation = first_observation(simulation, look)
                        found += FirstLooks.of(task, view, [seed], [observation]).sightings([seed])
            if found:
                yield (task, axis), found
        simulation.close()
        print(f"{task}: seen", flush=True)


def _judged(
    model: MergedModel,
    first: FirstSightings,
    seen: Mapping[tuple[str, str], Sequence[Sighting]],
    reading: Reading,
    *,
    varies: bool,
) -> dict[str, float]:
    """Axis to accuracy, their mean, and the mean AUROC of clean looks at each task when it is left out of the fit."""
    from policies.mergevla.routing.catalog import FITTED, to_fit
    from policies.mergevla.routing.features import features_of, labelled
    from policies.mergevla.routing.gaussian import fit
    from policies.mergevla.routing.study import leave_one_out

    fitting = replace(FITTED["calibrated"], varies=varies)
    parts = to_fit(fitting, model, first.frames, first.held_out, reading)
    fitted = fit(*parts, reading)
    right: dict[str, list[bool]] = {}
    for (task, axis), sightings in seen.items():
        chosen = fitted.scores(features_of(model, sightings, reading)).argmax(dim=1).tolist()
        right.setdefault(axis, []).extend(fitted.experts[place] == task for place in chosen)
    rates = {axis: sum(own) / len(own) for axis, own in right.items()}
    clean = labelled(model, {task: own for (task, axis), own in seen.items() if axis == CLEAN}, reading)
    unknown = leave_one_out(partial(fit, reading=reading), *parts, clean)
    return {**rates, "mean of these": sum(rates.values()) / len(rates), AUROC: unknown.auroc}
