"""Detection of tasks that no part of the shipped model has seen, by their first observations.

The known tasks' first observations are those of `routers`. The unknown tasks were fixed before any was scored; what
may be chosen was chosen on others (`unknown_scenes.DEVELOPMENT`), and on known tasks left out of the fit.
`DEMONSTRATIONS=FOLDER python -m studies routing --measure unknown_tasks`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain
from statistics import fmean
from typing import TYPE_CHECKING

from studies.routing.routers import first_of_demonstrations, observed
from studies.routing.unknown_scenes import REPORTED
from studies.shared import EXPERT_VIEW, table_of

if TYPE_CHECKING:
    from torch import Tensor

    from robogauntlet.results.analysis.routing import Detection
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.contract import FirstObservation
    from robogauntlet_mergevla.routing.demonstrations import RouterTrainingSet

    Score = Callable[[list[FirstObservation]], Tensor]

READ, HIDDEN = "instruction read", "instruction hidden"
ALL_LAYERS, WITH_PATCHES = "calibrated, all layers", "all layers and patches"
DETECTORS = ("calibrated", "self-trained", ALL_LAYERS, WITH_PATCHES)
ODDEST = 3
"""Patches of an observation that count."""
PATCHES = 3.0
"""Weight of their distance, chosen from 1, 3, 5 and 10 on other unknown tasks and on known ones left out."""


def measure() -> list[dict[str, object]]:
    """Score the unknown tasks against all known ones by each detector."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.evaluation import LeaveOneOutScores
    from robogauntlet_mergevla.routing_evaluation.evaluation import detection_of

    torch.set_num_threads(1)
    checkpoint = load_merged("zoo:merged")
    model = MergedModel(checkpoint.parts)
    first = first_of_demonstrations(model)
    known, unknown = observed(model.experts, EXPERT_VIEW), observed(tuple(REPORTED), EXPERT_VIEW)
    rows: list[dict[str, object]] = []
    for detector in DETECTORS:
        found: dict[str, dict[str, Detection]] = {}
        for sees, instruction in ((True, READ), (False, HIDDEN)):
            score, threshold = detectors(detector, model, checkpoint.fitted, first, sees=sees)
            usual = tuple(score(list(chain(*known.values()))).tolist())
            scores = {task: tuple(score(own).tolist()) for task, own in unknown.items()}
            found[instruction] = {
                task: detection_of(LeaveOneOutScores(usual, own, threshold)) for task, own in scores.items()
            }
        rows += rows_of(detector, found)
    columns = {"detector": "{detector}", "unknown task": "{unknown task}"}
    for instruction in (READ, HIDDEN):
        columns |= {
            f"AUROC, {instruction}": f"{{AUROC, {instruction}}}",
            "false positives" + " " * (instruction == HIDDEN): f"{{false positives, {instruction}}}",
            "rejected" + " " * (instruction == HIDDEN): f"{{rejected, {instruction}}}",
        }
    table_of(rows, columns)
    return rows


def rows_of(detector: str, found: Mapping[str, Mapping[str, Detection]]) -> list[dict[str, object]]:
    """A row for each unknown task, one for their means, and one for how many known observations are rejected."""
    rows = []
    usual: dict[str, object] = {"detector": detector, "unknown task": "known tasks"}
    usual |= {f"{measured}, {instruction}": "" for measured in ("AUROC", "false positives") for instruction in found}
    for task in (*REPORTED, "mean"):
        row: dict[str, object] = {"detector": detector, "unknown task": task}
        for instruction, by_task in found.items():
            own = list(by_task.values()) if task == "mean" else [by_task[task]]
            rejected = [one.rejected.rate for one in own if one.rejected is not None]
            alarms = [one.false_alarms.rate for one in own if one.false_alarms is not None]
            row |= {
                f"AUROC, {instruction}": f"{fmean(one.auroc for one in own):.3f}",
                f"false positives, {instruction}": f"{100 * fmean(one.false_positives for one in own):.1f} %",
                f"rejected, {instruction}": f"{100 * fmean(map(float, rejected)):.0f} %",
            }
            usual |= {f"rejected, {instruction}": f"{100 * fmean(map(float, alarms)):.1f} %"}
        rows.append(row)
    return [*rows, usual]


def detectors(
    name: str, model: MergedModel, stored: Mapping[str, Tensor], first: RouterTrainingSet, *, sees: bool
) -> tuple[Score, float]:
    """A score of observations, higher for an unknown task, and the threshold that 95 % of held-out ones stay below."""
    from robogauntlet_mergevla.routing.catalog import feature_spec_of
    from robogauntlet_mergevla.routing.features import features_of
    from robogauntlet_mergevla.routing.gaussian import GaussianRouterFit
    from robogauntlet_mergevla.routing.self_training import fit_self_trained

    pool, held_out = (list(chain(*part.values())) for part in (first.frames, first.held_out))
    spec = feature_spec_of(model.architecture, sees_instruction=sees)
    if name in (ALL_LAYERS, WITH_PATCHES):
        return refitted(model, first, held_out, sees=sees, patches=name == WITH_PATCHES)
    if name == "self-trained":
        (fitted,) = fit_self_trained(model, pool, held_out, [spec])
    else:
        prefix = f"calibrated/{'instructed' if sees else 'unaided'}/"
        own = {key.removeprefix(prefix): value for key, value in stored.items() if key.startswith(prefix)}
        fitted = GaussianRouterFit.from_tensors(own)
    return lambda seen: fitted.unknown(features_of(model, seen, spec)), fitted.threshold


def refitted(
    model: MergedModel, first: RouterTrainingSet, held_out: list[FirstObservation], *, sees: bool, patches: bool
) -> tuple[Score, float]:
    """The sum over layers of the logarithm of the distance to the nearest class of that layer's calibrated fit.

    With `patches`, three times the logarithm of how far the three oddest patches are from all patches of the
    demonstrations is added, in the middle layer's hidden states (K. Roth et al., arXiv 2106.08265).
    """
    import torch

    from robogauntlet_mergevla.routing.augmentation import augmented
    from robogauntlet_mergevla.routing.contract import hidden_states
    from robogauntlet_mergevla.routing.features import FeatureSpec, LabelledFeatures
    from robogauntlet_mergevla.routing.fitted_router import conformal_threshold
    from robogauntlet_mergevla.routing.gaussian import fit

    middle = model.architecture.language.layers // 2

    def read(seen: list[FirstObservation]) -> tuple[list[Tensor], Tensor]:
        """Features (n, d) of each layer, and the middle layer's patches (n, patches, width)."""
        batches, tokens = [], []
        for hidden in hidden_states(model, None, seen, sees_instruction=sees):
            pairs = zip(hidden.task, hidden.action, strict=True)
            batches.append([torch.cat([task.mean(dim=1), action.mean(dim=1)], dim=1) for task, action in pairs])
            tokens.append(hidden.task[middle].float())
        return [torch.cat(parts) for parts in zip(*batches, strict=True)], torch.cat(tokens)

    frames = {task: augmented(own, sees_instruction=sees) for task, own in first.frames.items()}
    labels = tuple(task for task, own in frames.items() for _ in own)
    parts = (LabelledFeatures(features, labels) for features in read(list(chain(*frames.values())))[0])
    fits = [fit(part, part, FeatureSpec(sees, layer)) for layer, part in enumerate(parts)]
    bank = read(list(chain(*first.frames.values())))[1].flatten(0, 1)
    spread = bank.std(dim=0)

    def score(seen: list[FirstObservation]) -> Tensor:
        layers, tokens = read(seen)
        each = (own.unknown(features).log() for own, features in zip(fits, layers, strict=True))
        total = torch.stack(list(each)).sum(dim=0)
        if not patches:
            return total
        odd = [torch.cdist(own / spread, bank / spread).amin(dim=1).topk(ODDEST).values.mean() for own in tokens]
        return total + PATCHES * torch.stack(odd).log()

    return score, conformal_threshold(score(held_out))
