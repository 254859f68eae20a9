"""Accuracy of routers on first observations of the nine tasks, with the instruction read and hidden.

Those without labels are beside the calibrated one: the paper's with values, keys and both (its Table 5), and the ideas
that lost. `self-trained` is fitted to three in four first observations of the demonstrations, whose tasks it does not
read. A row has its 900 decisions, as the experts' numbers in the order of their names, task by task.
`DEMONSTRATIONS=FOLDER python -m studies routing --measure routers`
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.episode import View
from studies.percent import SUFFIX, few
from studies.routing.unknown_scenes import SCENES, open_scene
from studies.shared import EXPERT_VIEW, open_task, table_of
from studies.tables import WRITTEN

if TYPE_CHECKING:
    from torch import Tensor

    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.contract import FirstObservation
    from robogauntlet_mergevla.routing.demonstrations import RouterTrainingSet

    Scores = Callable[[Sequence[FirstObservation], bool], Tensor]
    """Scores (n, experts) of observations, with the instruction read or hidden."""

SEEDS = range(few(100))
PAIR = ("pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3")
"""Tasks with one scene, which differ in where the goal may be."""
FRAMES, MORE_FRAMES = range(1_000_000, 1_000_000 + few(112)), range(1_000_000, 1_000_000 + few(1_400))
"""Training seeds whose first observations `more_frames` is fitted to; the second are those of `PAIR`."""
SHIPPED, AVERAGED = "shipped", "TA+S, averaged trunk"
SUBSPACES = ("projections=v", "projections=k", "projections=kv")


def measure() -> list[dict[str, object]]:
    """Route first observations of all nine tasks by every router and idea, on the shipped merge and the paper's."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel

    torch.set_num_threads(1)
    checkpoint = load_merged("zoo:merged")
    model, paper = MergedModel(checkpoint.parts), averaged_merge("zoo:experts")
    first = first_of_demonstrations(model)
    seen = list(chain(*observed(model.experts, EXPERT_VIEW).values()))
    ways: dict[str, tuple[str, Scores]] = {}
    for name in ("calibrated", "nearest-centroid", "delta-energy", "instruction-match", "random"):
        ways[name] = SHIPPED, by_router(name, model, checkpoint.fitted)
    ways["calibrated, all patches and more frames"] = SHIPPED, more_frames(model)
    ways |= {name: (SHIPPED, scores) for name, scores in unlabelled(model, first).items()}
    for name, merged in ((SHIPPED, model), (AVERAGED, paper)):
        paper_ways = paper_routers(merged, "zoo:experts", SUBSPACES)
        ways |= {f"{way} ({name})": (name, scores) for way, scores in paper_ways.items()}
    rows = []
    for way, (merged_as, scores) in ways.items():
        row: dict[str, object] = {"router": way.partition(" (")[0], "model": merged_as}
        for sees, instruction in ((True, "read"), (False, "hidden")):
            row |= row_of(instruction, scores(seen, sees), seen, model.experts)
        print({name: text for name, text in row.items() if not name.startswith("decisions")}, flush=True)
        rows.append(row)
    names = {"model": "model", "instruction read": "read", "hidden": "hidden", "hidden, one scene": "one scene, hidden"}
    table_of(rows, {"router": "{router}"} | {heading: f"{{{name}}}" for heading, name in names.items()})
    return rows


def averaged_merge(experts: str) -> MergedModel:
    """The paper's merge of the zoo's experts: task arithmetic with masks, and the mean of their trunks."""
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_parts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.merging.recipe import Recipe, TrunkRule
    from robogauntlet_mergevla.options import expert_folders
    from robogauntlet_mergevla.zoo import shipped

    folders = dict.fromkeys(expert_folders(shipped(experts)).values())
    recipe = Recipe(operator="ta", trunk=TrunkRule.MEAN, kept_blocks=1)
    return MergedModel(merge_parts(read_experts(folders), recipe))


def row_of(
    instruction: str, scores: Tensor, seen: Sequence[FirstObservation], experts: Sequence[str]
) -> dict[str, object]:
    """Accuracy with its 95 % Wilson interval, that on the pair of tasks with one scene, and the decisions."""
    chosen = scores.argmax(dim=1).tolist()
    right: dict[str, list[bool]] = {task: [] for task in experts}
    for one, choice in zip(seen, chosen, strict=True):
        right[one.task].append(experts[choice] == one.task)
    return {
        instruction: interval(list(chain(*right.values()))),
        f"one scene, {instruction}": interval([*right[PAIR[0]], *right[PAIR[1]]]),
        f"decisions, {instruction}": "".join(map(str, chosen)),
    }


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions."""
    names = ("read", "hidden")
    return [dict(row) | {name: interval(right(row[f"decisions, {name}"])) for name in names} for row in rows]


def right(decisions: str) -> list[bool]:
    """Which decisions name the expert of their task: a digit each, in the order of tasks, `SEEDS` of each task."""
    return [int(choice) == place // len(SEEDS) for place, choice in enumerate(decisions)]


def interval(right: Sequence[bool]) -> str:
    """A rate in percent with its 95 % Wilson interval."""
    ends = wilson_interval(sum(right), len(right))
    assert ends is not None
    return f"{100 * sum(right) / len(right):.1f} % [{100 * ends.low:.0f}, {100 * ends.high:.0f}]"


def by_router(name: str, model: MergedModel, stored: Mapping[str, Tensor]) -> Scores:
    """The scores of a router of the catalogue."""
    import torch

    from robogauntlet_mergevla.routing.catalog import router

    def scores(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        routed = router(name, sees_instruction=sees, stored=stored).route(seen, model)
        return torch.tensor([[one.scores[expert] for expert in model.experts] for one in routed])

    return scores


def more_frames(model: MergedModel) -> Scores:
    """The classes of `calibrated` with each patch's place, from more frames of the tasks with one scene, unmodified."""
    from robogauntlet_mergevla.routing import gaussian
    from robogauntlet_mergevla.routing.catalog import feature_spec_of
    from robogauntlet_mergevla.routing.features import Pooling, features_of, labelled_features

    frames = observed([task for task in model.experts if task not in PAIR], EXPERT_VIEW, FRAMES)
    frames |= observed(PAIR, EXPERT_VIEW, MORE_FRAMES)

    def scores(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        middle = feature_spec_of(model.architecture, sees_instruction=sees)
        spec = replace(middle, pooling=Pooling.FLAT)
        known = labelled_features(model, frames, spec)
        fit = gaussian.fit(known, known, spec)  # held-out frames give a temperature, which changes no choice
        assert fit.experts == tuple(model.experts)
        return fit.scores(features_of(model, seen, spec))

    return scores


def unlabelled(model: MergedModel, first: RouterTrainingSet) -> dict[str, Scores]:
    """`self-trained`, and what lost to it: its parts, for one observation and standardised over unlabelled ones."""
    import torch

    from robogauntlet_mergevla.routing.catalog import feature_spec_of
    from robogauntlet_mergevla.routing.deltas import agreement, directions, energies
    from robogauntlet_mergevla.routing.fitted_router import FittedRouter
    from robogauntlet_mergevla.routing.self_training import RANK, fit_self_trained

    pool, held_out = (list(chain(*part.values())) for part in (first.frames, first.held_out))
    specs = [feature_spec_of(model.architecture, sees_instruction=sees) for sees in (True, False)]
    fits = dict(zip((True, False), fit_self_trained(model, pool, held_out, specs), strict=True))
    whole, rows = directions(model), directions(model, RANK)
    images = [place for place, name in enumerate(rows) if not name.startswith("language.")]

    def energy(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        return -energies(model, rows, seen, sees_instruction=sees).sum(dim=1)

    def seen_energy(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        return -energies(model, rows, seen, sees_instruction=sees)[:, images].sum(dim=1)

    def agreed(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        return agreement(model, seen)

    def standardised(*parts: Scores) -> Scores:
        def scores(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
            total = torch.zeros(1)
            for part in parts:
                known = part(pool[::3], sees)
                total = total + (part(seen, sees) - known.mean(dim=0)) / known.std(dim=0)
            return total

        return scores

    def self_trained(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
        routed = FittedRouter("self-trained", fits[sees]).route(seen, model)
        return torch.tensor([[one.scores[expert] for expert in model.experts] for one in routed])

    return {
        "self-trained": self_trained,
        "most energy of the delta": lambda seen, sees: energies(model, whole, seen, sees_instruction=sees).sum(dim=1),
        "least energy in the delta's row space": energy,
        "the same, standardised": standardised(energy),
        "the same, of layers that read images, standardised": standardised(seen_energy),
        "agreement of actions with the base": agreed,
        "the same agreement, standardised": standardised(agreed),
        "these three, standardised": standardised(energy, seen_energy, agreed),
    }


def paper_routers(model: MergedModel, experts: str, options: Sequence[str]) -> dict[str, Scores]:
    """The paper's router as coded, by the experts' own projections, and as written; hidden states computed once."""
    import torch

    from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_tensors
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.options import expert_folders
    from robogauntlet_mergevla.routing.contract import hidden_states
    from robogauntlet_mergevla.routing.subspace import PaperCodedRouter, PaperWrittenRouter, SubspaceOptions
    from robogauntlet_mergevla.zoo import shipped

    folders = {model.expert_of[task]: folder for task, folder in expert_folders(shipped(experts)).items()}
    own = {expert: load_tensors(folder)[0] for expert, folder in folders.items()}

    class Own(MergedModel):
        """The model with the experts' own, unmerged projections."""

        def projections(self, expert: str, block: int) -> dict[str, Tensor]:
            names = ("k_adapter", "k_task", "v_adapter", "v_task")
            return {name: own[expert][f"action_expert.blocks.{block}.{name}.weight"] for name in names}

    unmerged = Own(model.parts)
    routers: dict[str, tuple[PaperCodedRouter | PaperWrittenRouter, MergedModel]] = {}
    for one in map(SubspaceOptions.read, options):
        for router, merged in ((PaperCodedRouter(one), unmerged), (PaperWrittenRouter(one), model)):
            if not (merged is model and one.block == model.architecture.language.layers - 1):  # the default there
                routers[router.name] = router, merged
    found: dict[bool, dict[str, Tensor]] = {}

    def all_scores(seen: Sequence[FirstObservation], sees: bool) -> dict[str, Tensor]:
        scores: dict[str, list[Tensor]] = {name: [] for name in routers}
        for expert in model.experts:
            spaces = {name: router._subspaces_of(merged, expert) for name, (router, merged) in routers.items()}
            columns: dict[str, list[Tensor]] = {name: [] for name in routers}
            for hidden in hidden_states(model, expert, seen, sees_instruction=sees):
                for name, (router, merged) in routers.items():
                    each = [router._score(hidden, space, router._layer(merged)) for space in spaces[name]]
                    columns[name].append(torch.stack(each).mean(dim=0))
            for name, parts in columns.items():
                scores[name].append(torch.cat(parts))
        return {name: torch.stack(columns, dim=1) for name, columns in scores.items()}

    def of(name: str) -> Scores:
        def scores(seen: Sequence[FirstObservation], sees: bool) -> Tensor:
            if sees not in found:
                found[sees] = all_scores(seen, sees)
            return found[sees][name]

        return scores

    return {name: of(name) for name in sorted(routers)}


def first_of_demonstrations(model: MergedModel) -> RouterTrainingSet:
    """First observations of the demonstrations in the folder that `DEMONSTRATIONS` names."""
    from robogauntlet.policies.training.dataset import datasets_of
    from robogauntlet_mergevla.routing.demonstrations import first_observations

    folder = Path(os.environ.get("DEMONSTRATIONS", f"runs/zoo{SUFFIX}/demonstrations"))
    return first_observations(datasets_of([folder], model.experts), model.architecture.cameras)


def observed(tasks: Sequence[str], view: View, seeds: Sequence[int] = SEEDS) -> dict[str, list[FirstObservation]]:
    """First observations of these seeds, clean, rendered once and cached beside the measurements."""
    from robogauntlet_mergevla.routing.observation_cache import (
        ObservationCache,
        file_of,
        load_observations,
        save_observations,
    )

    folder = WRITTEN / f"first_observations/{seeds[0]}-{len(seeds)}"
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for task in tasks:
        path = file_of(folder, task)
        if not path.exists() or not load_observations(path).covers(view, seeds):
            simulation = open_scene(task, view) if task in SCENES else open_task(task, view)
            images = []
            for seed in seeds:
                simulation.reset(seed)
                images.append(simulation.observe())
            simulation.close()
            save_observations(ObservationCache.of(task, view, seeds, images), path)
            print(f"{task}: observed", flush=True)
        found[task] = load_observations(path).observations(seeds)
    return found
