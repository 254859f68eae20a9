"""Accuracy of the shipped router on first observations under each axis; no episode is played.

The router is fitted to demonstrations in four ways, the shipped one last; see `scripts/zoo.sh` for the folder.
`DEMONSTRATIONS=FOLDER python -m tests.benchmarks shifted_routing`
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.episodes.first_observation import Snapshot, first_observation
from robogauntlet.suites.episode import CLEAN, Condition, RenderProfile, View
from tests.benchmarks.shared import open_task, table

if TYPE_CHECKING:
    from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet.policies.mergevla.routing.contract import FirstObservation
    from robogauntlet.policies.mergevla.routing.demonstrations import RouterTrainingSet
    from robogauntlet.policies.mergevla.routing.features import FeatureSpec

SEEDS = range(2_000_000, 2_000_012)
"""Seeds that neither training (from 1,000,000) nor the reports (from 0) use."""
AXES = (
    *("camera-orbit", "camera-distance", "field-of-view", "camera-bump", "illuminance", "light-direction"),
    *("colour-temperature", "table", "distractors", "object-position", "robot-start", "noise", "blur"),
)
LEVELS = dict.fromkeys(AXES, (2, 4)) | {"instruction": (1, 2, 3, 4, 5)}
"""Severities of the axes that change the first observation."""
UNCHANGED, AUGMENTED = "unchanged", "augmented"
AUROC = "AUROC of unknown tasks, clean"


def measure() -> list[dict[str, object]]:
    """Accuracy by axis, pooled over tasks and severities, and AUROC of unknown tasks, for each layer and fit."""
    import torch

    from robogauntlet.policies.mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet.policies.mergevla.routing.catalog import feature_spec_of
    from robogauntlet.policies.mergevla.routing.demonstrations import first_observations
    from robogauntlet.policies.mergevla.routing.features import FeatureSpec
    from robogauntlet.policies.training.dataset import datasets_of

    torch.set_num_threads(1)
    model = MergedModel(load_merged("zoo:merged").parts)
    view = View(model.architecture.cameras, model.architecture.image_size, RenderProfile.FAST)
    folder = Path(os.environ.get("DEMONSTRATIONS", "runs/zoo/demonstrations"))
    first = first_observations(datasets_of([folder], model.experts), view.cameras)
    seen = dict(_first_observations(model.experts, view))
    rows = []
    for sees in (True, False):
        ways = {
            f"{frames}, {layer}": _evaluated(model, first, seen, feature_spec, augments=frames == AUGMENTED)
            for frames in (UNCHANGED, AUGMENTED)
            for layer, feature_spec in (
                ("last", FeatureSpec(sees)),
                ("middle", feature_spec_of(model.architecture, sees_instruction=sees)),
            )
        }
        print(f"\nInstruction {'read' if sees else 'hidden'}, {sum(map(len, seen.values()))} first observations")
        names = next(iter(ways.values()))
        shares = [(name, *(f"{100 * own[name]:.1f} %" for own in ways.values())) for name in names if name != AUROC]
        table(("", *ways), [*shares, (AUROC, *(f"{own[AUROC]:.3f}" for own in ways.values()))])
        rows += [{"sees_instruction": sees, "way": way, **own} for way, own in ways.items()]
    return rows


def _first_observations(tasks: Sequence[str], view: View) -> Iterator[tuple[tuple[str, str], list[FirstObservation]]]:
    """First observations of each task under each axis that it supports."""
    from robogauntlet.policies.mergevla.routing.observation_cache import ObservationCache

    for task in tasks:
        simulation = open_task(task, view)
        for axis, severities in {CLEAN: (0,), **LEVELS}.items():
            found: list[FirstObservation] = []
            for severity in severities:
                for seed in SEEDS:
                    snapshot = Snapshot(task, Condition(axis, severity), seed, view)
                    with contextlib.suppress(AdapterError):
                        observation = first_observation(simulation, snapshot)
                        found += ObservationCache.of(task, view, [seed], [observation]).observations([seed])
            if found:
                yield (task, axis), found
        simulation.close()
        print(f"{task}: observed", flush=True)


def _evaluated(
    model: MergedModel,
    first: RouterTrainingSet,
    seen: Mapping[tuple[str, str], Sequence[FirstObservation]],
    feature_spec: FeatureSpec,
    *,
    augments: bool,
) -> dict[str, float]:
    """Axis to accuracy, their mean, and the mean AUROC of clean observations of each task left out of the fit."""
    from robogauntlet.orchestrator.routing_evaluation.evaluation import detection_of
    from robogauntlet.policies.mergevla.routing.catalog import FITTED, fitting_features
    from robogauntlet.policies.mergevla.routing.evaluation import leave_one_out
    from robogauntlet.policies.mergevla.routing.features import features_of, labelled_features
    from robogauntlet.policies.mergevla.routing.gaussian import fit

    fitting = replace(FITTED["calibrated"], augments=augments)
    parts = fitting_features(fitting, model, first.frames, first.held_out, feature_spec)
    fitted = fit(*parts, feature_spec)
    right: dict[str, list[bool]] = {}
    for (task, axis), observations in seen.items():
        chosen = fitted.scores(features_of(model, observations, feature_spec)).argmax(dim=1).tolist()
        right.setdefault(axis, []).extend(fitted.experts[place] == task for place in chosen)
    rates = {axis: sum(own) / len(own) for axis, own in right.items()}
    clean = labelled_features(model, {task: own for (task, axis), own in seen.items() if axis == CLEAN}, feature_spec)
    left_out = leave_one_out(partial(fit, feature_spec=feature_spec), *parts, clean)
    auroc = fmean(detection_of(scores).auroc for scores in left_out.values())
    return {**rates, "mean of these": fmean(rates.values()), AUROC: auroc}
