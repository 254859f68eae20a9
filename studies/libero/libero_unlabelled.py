"""Routers without labels on a base that has seen none of the tasks: what labels which first observations rightly.

The classifier of `self-trained` is fitted to first observations of training seeds without their tasks, labelled by one
kind of evidence each, with the instruction hidden, and asked about stored states that no choice looked at. A row has
its decisions, as the experts' numbers in the order of their names, task by task.
`python -m studies libero --measure libero_unlabelled`, after `robogauntlet env create libero`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robogauntlet.suites.episode import RenderProfile, View
from studies.libero.libero_experts import SUITES, tasks_of
from studies.libero.libero_merges import MERGED
from studies.libero.libero_routers import NAMES, rates_of
from studies.percent import few
from studies.routing.routers import interval
from studies.shared import table_of
from studies.tables import WRITTEN

if TYPE_CHECKING:
    from torch import Tensor

    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.contract import FirstObservation

    Evidence = Callable[[MergedModel, Sequence[FirstObservation]], Tensor]

TRAINING, TEST = range(1_000_000, 1_000_000 + few(15)), range(20, 20 + few(20))
"""Seeds to fit to, and stored states to be asked about; the first twenty states were those of development."""
COLUMNS = {
    "labels by": "{evidence}",
    "right at first": "{first}",
    "right after self-training": "{labels}",
    "new states routed right": "{hidden}",
}


def measure() -> list[dict[str, Any]]:
    """A row for each kind of evidence."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing import gaussian
    from robogauntlet_mergevla.routing.catalog import feature_spec_of
    from robogauntlet_mergevla.routing.features import LabelledFeatures, features_of
    from robogauntlet_mergevla.routing.self_training import COMPONENTS, self_labels, standardised
    from robogauntlet_mergevla.routing_evaluation.first_observations import collect_first_observations

    torch.set_num_threads(1)
    model = MergedModel(load_merged(MERGED).parts)
    assert list(model.experts) == NAMES
    view = View(model.architecture.cameras, model.architecture.image_size, RenderProfile.FAST_2)
    every = [task for suite in SUITES for task in tasks_of(suite)]

    def seen(name: str, seeds: range) -> list[FirstObservation]:
        caches = collect_first_observations(every, view, seeds, WRITTEN / f"first_observations/{name}", print).by_task
        return [one for task in every for one in caches[task].observations(seeds)]

    pool, test = seen("libero-training", TRAINING), seen("libero-test", TEST)
    spec = feature_spec_of(model.architecture, sees_instruction=False)
    known, asked = features_of(model, pool, spec), features_of(model, test, spec)
    truth = [NAMES.index(model.expert_of[one.task]) for one in pool]
    rows = []
    for name, evidence in kinds().items():
        found = standardised(evidence(model, pool))
        labels = self_labels(found, known, spec)
        named = LabelledFeatures(known, tuple(f"{label:06}" for label in labels.tolist()))
        fitted = gaussian.fit(named, named, spec, COMPONENTS)
        chosen = [int(fitted.experts[place]) for place in fitted.scores(asked).argmax(dim=1).tolist()]
        first = [one == other for one, other in zip(found.argmax(dim=1).tolist(), truth, strict=True)]
        after = [one == other for one, other in zip(labels.tolist(), truth, strict=True)]
        row: dict[str, Any] = {"evidence": name, "first": interval(first), "labels": interval(after)}
        row |= {"decisions": "".join(map(str, chosen)), "hidden": ""}
        rows.append(row)
        print(name, row["first"], row["labels"], rates_of("hidden", row["decisions"])["hidden"], flush=True)
    rows = counted(rows)
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions."""
    return [dict(row) | {"hidden": rates_of("hidden", row["decisions"])["hidden"]} for row in rows]


def kinds() -> dict[str, Evidence]:
    """Kinds of evidence, each higher for the likelier expert, shape (n, experts)."""
    import torch

    from robogauntlet_mergevla.routing.deltas import agreement, chunks_told, directions, energies, stability
    from robogauntlet_mergevla.routing.self_training import RANK

    def energy(model: MergedModel, seen: Sequence[FirstObservation]) -> Tensor:
        return -energies(model, directions(model, RANK), seen, sees_instruction=False).sum(dim=1)

    def spread(model: MergedModel, seen: Sequence[FirstObservation]) -> Tensor:
        return torch.stack(
            [chunks_told(model, one, one, seen).std(dim=0).mean(dim=(1, 2)) for one in model.experts], dim=1
        )

    def words(model: MergedModel, seen: Sequence[FirstObservation]) -> Tensor:
        def alike(one: str, other: str) -> float:
            first, second = set(one.lower().split()), set(other.lower().split())
            return len(first & second) / len(first | second)

        known = {expert: [model.instructions[task] for task in model.tasks[expert]] for expert in model.experts}
        rows = [[max(alike(one.instruction, text) for text in known[name]) for name in model.experts] for one in seen]
        return torch.tensor(rows)

    return {
        "least energy in the delta's row space": energy,
        "most agreement of actions with the base": agreement,
        "least agreement of actions with the base": lambda model, seen: -agreement(model, seen),
        "actions that depend most on which of the expert's instructions is told": spread,
        "actions that change least with noise on the images": stability,
        "words shared with an instruction of the expert, read in training only": words,
    }
