"""Routers of merges of 3 to 20 experts of Meta-World, on first observations: accuracy and time of a decision.

Reads the merges of the benchmark `more_experts`, in the same folder, or makes them.
`META_WORLD=FOLDER python -m studies more_experts --measure more_experts_routing`
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from statistics import median
from string import ascii_lowercase
from typing import Any

from robogauntlet.suites.episode import RenderProfile, View
from robogauntlet_mergevla.options import expert_folders
from studies.more_experts.more_experts import NUMBERS, WAYS, folder_of_experts, folder_of_merge, in_order, merged
from studies.percent import few
from studies.routing.routers import by_router, interval, observed
from studies.shared import table_of

ROUTERS = {
    **dict.fromkeys(("calibrated", "nearest-centroid", "self-trained"), "magnitude-2"),
    "paper-coded": "ta-s-averaged-trunk",
}
"""Router to the merge that it routes."""
SEEDS = few(50)
TIMED = few(20)
"""Decisions that are timed, one at a time."""
COLUMNS = {
    "router": "{router}",
    "experts": "{experts}",
    "instruction read": "{read}",
    "hidden": "{hidden}",
    "passes": "{passes}",
    "decision (ms)": "{milliseconds:.0f}",
}


def measure() -> list[dict[str, object]]:
    """A row for each router and number of experts, with its decisions."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing.catalog import router
    from robogauntlet_mergevla.routing.evaluation import evaluate_routers

    torch.set_num_threads(1)
    folder = folder_of_experts()
    tasks = in_order(expert_folders(folder / "experts"))
    rows: list[dict[str, object]] = []
    for number in (number for number in NUMBERS if number <= len(tasks)):
        for name, way in ROUTERS.items():
            merged(folder, tasks[:number], way, WAYS[way])
            checkpoint = load_merged(folder_of_merge(folder, number, way))
            model = MergedModel(checkpoint.parts)
            view = View(model.architecture.cameras, render_profile=RenderProfile.FAST_2)
            first = observed(tasks[:number], view, range(SEEDS))
            seen = list(chain(*first.values()))
            blind = router(name, sees_instruction=False, stored=checkpoint.fitted)
            (timed,) = evaluate_routers([blind], model, seen[:: max(1, len(seen) // TIMED)]).routers
            row: dict[str, object] = {
                "router": name,
                "experts": number,
                "passes": timed.passes,
                "milliseconds": 1000 * median(one.routing.latency_s for one in timed.answers),
                "tasks": tasks[:number],
            }
            for sees, instruction in ((True, "read"), (False, "hidden")):
                chosen = by_router(name, model, checkpoint.fitted)(seen, sees).argmax(dim=1).tolist()
                decisions = "".join(ascii_lowercase[tasks.index(model.experts[choice])] for choice in chosen)
                row |= {f"decisions, {instruction}": decisions, instruction: interval(right(decisions))}
            print({key: row[key] for key in ("router", "experts", "read", "hidden", "milliseconds")}, flush=True)
            rows.append(row)
    rows.sort(key=lambda row: list(ROUTERS).index(str(row["router"])))
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions."""
    rates = {"read": "decisions, read", "hidden": "decisions, hidden"}
    return [dict(row) | {name: interval(right(row[of])) for name, of in rates.items()} for row in rows]


def right(decisions: str) -> list[bool]:
    """Which decisions name the expert of their task: a letter each, in the order of tasks, `SEEDS` of each task."""
    return [choice == ascii_lowercase[place // SEEDS] for place, choice in enumerate(decisions)]
