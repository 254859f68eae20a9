"""L1 of the shipped experts on demonstrations that they were not trained on, under many ways of merging.

This measures not speed but the loss by merging, before any episode is played. Of each task's demonstrations a tenth is
held out; lambda is chosen for each task on half of that, and the other half scores every way. Demonstrations of other
seeds than the training's are as good, since nothing is trained on them here.
`DEMONSTRATIONS=FOLDER python -m studies merging --measure merges`
"""

import os
from pathlib import Path

from studies.shared import kilobytes, table_of

WAYS = {
    "naive mean, everything merged": {"operator": "mean", "masks": "none", "kept_blocks": 0, "merge_output": True},
    "mean, no masks, k = 1": {"operator": "mean", "masks": "none"},
    "TSV, no masks, k = 1": {"operator": "tsv", "masks": "none"},
    "EMR, k = 1": {"operator": "emr", "masks": "emr"},
    "TA+S, averaged trunk, k = 1": {"operator": "ta", "trunk": "mean"},
    "TIES+S, averaged trunk, k = 1": {"operator": "ties", "trunk": "mean"},
    "own adapters, averaged trunk, k = 1": {"backbone": "select", "trunk": "mean"},
    "own adapters, TIES+S trunk, k = 1": {"backbone": "select"},
    "TA+S, k = 0, output merged": {"operator": "ta", "kept_blocks": 0, "merge_output": True},
    "TA+S, k = 1": {"operator": "ta"},
    "TIES+S, k = 1": {"operator": "ties"},
    "TIES+S as published, k = 1": {"operator": "ties-published"},
    "KnOTS-TIES+S, k = 1": {"operator": "knots-ties"},
    "WUDI+S, closed form, k = 1": {"operator": "wudi"},
    "WUDI+S, Adam as published, k = 1": {"operator": "wudi-adam"},
    "TSV+S, k = 0, output merged": {"operator": "tsv", "kept_blocks": 0, "merge_output": True},
    "TSV+S, k = 1": {"operator": "tsv"},
    "TSV+S, k = 2": {"operator": "tsv", "kept_blocks": 2},
    "TSV+S, k = 3": {"operator": "tsv", "kept_blocks": 3},
    **{
        f"not merged, {bits} bits": {"operator": "none", "masks": "none", "options": {"bits": bits}}
        for bits in (8, 6, 4, 3, 2)
    },
    "signs of rows without a merged vector, k = 1": {"operator": "flat", "masks": "signs"},
    "signs of TIES, k = 1": {"operator": "ties", "masks": "signs"},
    "signs of magnitudes, k = 0, output merged": {
        "operator": "magnitude",
        "masks": "signs",
        "kept_blocks": 0,
        "merge_output": True,
    },
    "signs of magnitudes, k = 0": {"operator": "magnitude", "masks": "signs", "kept_blocks": 0},
    "signs of magnitudes, k = 1": {"operator": "magnitude", "masks": "signs"},
    "signs of magnitudes, k = 2": {"operator": "magnitude", "masks": "signs", "kept_blocks": 2},
    "two bits of rows without a merged vector, k = 1": {"operator": "flat", "masks": "signs", "rounds": 2},
    "two bits of magnitudes, k = 1 (shipped)": {"operator": "magnitude", "masks": "signs", "rounds": 2},
}


BASE, EXPERTS = "base (joint training)", "experts"


def measure() -> list[dict[str, object]]:
    """Merge the zoo's experts in each way, choose lambda per task, and score each task's held-out episodes."""
    import torch

    from robogauntlet.policies.training.dataset import Demonstrations, find_datasets
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, read_tensors
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_parts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import tensors_of_parts
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS
    from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
    from robogauntlet_mergevla.options import expert_folders
    from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture, HeldOut
    from robogauntlet_mergevla.training.lambda_selection import choose_lambdas, experts_l1, held_out_l1
    from robogauntlet_mergevla.zoo import shipped

    torch.set_num_threads(1)
    folder = Path(os.environ.get("DEMONSTRATIONS", "runs/zoo/demonstrations"))
    pool = DatasetMixture([Demonstrations(path) for path in find_datasets([folder])])
    folders = expert_folders(shipped("zoo:experts")).values()
    experts = read_experts(folders)
    base = load_checkpoint(shipped("zoo:base"))
    sizes = {BASE: 0.0, EXPERTS: sum(kilobytes(read_tensors(place / WEIGHTS)) for place in folders) / len(folders)}
    scores = {
        EXPERTS: experts_l1(experts, pool, part=HeldOut.SCORE),
        BASE: held_out_l1(lambda _: base.model, base.metadata.statistics, pool, part=HeldOut.SCORE),
    }
    for name, options in WAYS.items():
        recipe = Recipe(**options)  # type: ignore[arg-type]
        if recipe.masks is MaskRule.TASK:
            recipe, _ = choose_lambdas(experts, recipe, pool)
        parts = merge_parts(experts, recipe)
        sizes[name] = kilobytes(tensors_of_parts(parts)) / len(folders)
        scores[name] = held_out_l1(MergedModel(parts).model, parts.statistics, pool, part=HeldOut.SCORE)
        print(f"{name}: {sum(scores[name].values()) / len(scores[name]):.4f}", flush=True)
    means = {name: sum(found.values()) / len(found) for name, found in scores.items()}
    rows = [
        {"way": name, "mean": means[name], "kilobytes": sizes[name], **scores[name]}
        for name in sorted(means, key=lambda name: means[name])
    ]
    short = {task.partition("/")[2]: f"{{{task}:.3f}}" for task in experts.by_name}
    first = {"way of merging": "{way}", "kB per task": "{kilobytes:,.0f}", "mean": "{mean:.3f}"}
    table_of(rows, first | short)
    return rows
