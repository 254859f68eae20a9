"""Detection of tasks that no part of the shipped model has seen, by their first observations.

The known tasks' first observations are those of `routers`. The unknown tasks were fixed before any was scored, and
nothing was chosen on them. `python -m studies routing --measure unknown_tasks` keeps the scores beside the rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

import pandas as pd

from robogauntlet.results.analysis.routing import Detection, detection
from studies.routing.routers import observed
from studies.routing.unknown_scenes import SCENES
from studies.shared import EXPERT_VIEW, table_of
from studies.tables import episodes_of, write_episodes

INSTRUCTION = {"instruction read": True, "instruction hidden": False}
DETECTORS = ("calibrated", "self-trained")
UNKNOWN = (
    "maniskill/PokeCube-v1",
    "maniskill/RollBall-v1",
    "maniskill/PlaceSphere-v1",
    "maniskill/PickCube-v1",
    "maniskill/StackPyramid-v1",
    *SCENES,
    "robosuite/NutAssemblyRound",
    "robosuite/PickPlaceCan",
)
SCORE = ("detector", "instruction", "task", "seed", "unknown_score")
COLUMNS = {"detector": "{detector}", "unknown task": "{unknown task}"}
for _place, _read in enumerate(INSTRUCTION):
    COLUMNS |= {
        f"AUROC, {_read}": f"{{AUROC, {_read}}}",
        "false positives" + " " * _place: f"{{false positives, {_read}}}",
        "rejected" + " " * _place: f"{{rejected, {_read}}}",
    }


def measure() -> list[dict[str, Any]]:
    """Score the unknown tasks, and all known ones, by each detector of `zoo:merged`."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.catalog import FITTED, feature_spec_of
    from robogauntlet_mergevla.routing.features import features_of

    torch.set_num_threads(1)
    checkpoint = load_merged("zoo:merged")
    model = MergedModel(checkpoint.parts)
    seen = observed([*model.experts, *UNKNOWN], EXPERT_VIEW)
    scores, thresholds = [], {}
    for detector in DETECTORS:
        for instruction, sees in INSTRUCTION.items():
            prefix = f"{detector}/{'instructed' if sees else 'unaided'}/"
            stored = checkpoint.fitted
            own = {key.removeprefix(prefix): value for key, value in stored.items() if key.startswith(prefix)}
            fitted: Any = FITTED[detector].read(own)
            thresholds[detector, instruction] = float(fitted.threshold)
            spec = feature_spec_of(model.architecture, sees_instruction=sees)
            for task, observations in seen.items():
                values = fitted.unknown(features_of(model, observations, spec)).tolist()
                scores += [(detector, instruction, task, seed, value) for seed, value in enumerate(values)]
    frame = pd.DataFrame(scores, columns=SCORE)
    write_episodes("unknown_tasks", frame, SCORE[:4])
    rows = rows_of(frame, thresholds)
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept scores; thresholds are taken from the rows."""
    thresholds = {(row["detector"], name): row[f"threshold, {name}"] for row in rows for name in INSTRUCTION}
    return rows_of(episodes_of("routing", "unknown_tasks"), thresholds)


def rows_of(frame: pd.DataFrame, thresholds: Mapping[tuple[str, str], float]) -> list[dict[str, Any]]:
    """A row for each detector and unknown task, one for their means, and one for the known tasks.

    Args:
        frame: A row per first observation, with the columns `SCORE`.
        thresholds: Detector and instruction to the score above which an observation is rejected.
    """
    rows = []
    for detector in DETECTORS:
        found: dict[str, dict[str, Detection]] = {}
        for instruction in INSTRUCTION:
            own = frame[(frame.detector == detector) & (frame.instruction == instruction)]
            own = own.assign(rejected=own.unknown_score > thresholds[detector, instruction])
            known = own[~own.task.isin(UNKNOWN)]
            each = {task: detection(known, own[own.task == task]) for task in UNKNOWN}
            found[instruction] = {task: one for task, one in each.items() if one is not None}
        stored = {f"threshold, {name}": thresholds[detector, name] for name in INSTRUCTION}
        for task in (*UNKNOWN, "mean", "known tasks"):
            row = {"detector": detector, "unknown task": task, **stored}
            for instruction, by_task in found.items():
                row |= _cells(task, instruction, [by_task[task]] if task in by_task else [*by_task.values()])
            rows.append(row)
    return rows


def _cells(task: str, instruction: str, own: Sequence[Detection]) -> dict[str, str]:
    is_known = task == "known tasks"
    shares = [one.false_alarms if is_known else one.rejected for one in own]
    rejected = fmean(share.rate for share in shares if share is not None and share.rate is not None)
    return {
        f"AUROC, {instruction}": "" if is_known else f"{fmean(one.auroc for one in own):.3f}",
        f"false positives, {instruction}": ""
        if is_known
        else f"{100 * fmean(one.false_positives for one in own):.1f} %",
        f"rejected, {instruction}": f"{100 * rejected:.1f} %" if is_known else f"{100 * rejected:.0f} %",
    }
