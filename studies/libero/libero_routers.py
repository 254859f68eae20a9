"""Which of LIBERO's experts each router chooses, from the first images of the episodes of `libero_experts`.

The paper's router is beside those of `zoo:libero-merged`, on that merge and on the paper's. A row has its decisions, as
the experts' numbers in the order of their names, task by task. No episode is played. `python -m studies libero
--measure libero_routers`, after `robogauntlet env create libero`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robogauntlet.suites.episode import RenderProfile, View
from studies.libero.libero_experts import EXPERTS, STATES, SUITES, tasks_of
from studies.libero.libero_merges import MERGED
from studies.percent import few
from studies.routing.routers import AVERAGED, SHIPPED, averaged_merge, by_router, interval, paper_routers
from studies.shared import table_of
from studies.tables import WRITTEN

if TYPE_CHECKING:
    from studies.routing.routers import Scores

OPTIONS = ("projections=v", "projections=k", "projections=kv")
"""Of the paper's router (its Table 5)."""
NAMES = [f"libero-{suite}" for suite in sorted(SUITES)]
"""The experts in the order in which decisions number them."""


def measure() -> list[dict[str, object]]:
    """A row for each router and model."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.routing_evaluation.first_observations import collect_first_observations

    torch.set_num_threads(1)
    checkpoint = load_merged(MERGED)
    model = MergedModel(checkpoint.parts)
    assert list(model.experts) == NAMES
    view = View(model.architecture.cameras, model.architecture.image_size, RenderProfile.FAST_2)
    every, seeds = [task for suite in SUITES for task in tasks_of(suite)], range(few(STATES))
    caches = collect_first_observations(every, view, seeds, WRITTEN / "first_observations", print).by_task
    seen = [one for task in every for one in caches[task].observations(seeds)]
    ways: dict[str, tuple[str, Scores]] = {}
    for name in ("calibrated", "nearest-centroid", "instruction-match", "delta-energy", "random"):
        ways[name] = SHIPPED, by_router(name, model, checkpoint.fitted)
    for title, merged in ((SHIPPED, model), (AVERAGED, averaged_merge(EXPERTS))):
        routers = paper_routers(merged, EXPERTS, OPTIONS)
        ways |= {f"{name} ({title})": (title, scores) for name, scores in routers.items()}
    rows = []
    for way, (title, scores) in ways.items():
        row: dict[str, object] = {"router": way.partition(" (")[0], "model": title}
        for sees, instruction in ((True, "read"), (False, "hidden")):
            decisions = "".join(str(int(choice)) for choice in scores(seen, sees).argmax(dim=1))
            row |= {f"decisions, {instruction}": decisions, **rates_of(instruction, decisions)}
        rows.append(row)
    both = {"instruction read": "read", "once per suite": "suites, read", "hidden": "hidden"}
    names = {"router": "router", "model": "model", **both, "hidden, once per suite": "suites, hidden"}
    table_of(rows, {heading: f"{{{name}}}" for heading, name in names.items()})
    return rows


def suites_of(decisions: Sequence[str]) -> list[str]:
    """The suite of each decision: all have equally many."""
    return [suite for suite in SUITES for _ in range(len(decisions) // len(SUITES))]


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions."""
    found = []
    for row in rows:
        read, hidden = (rates_of(name, row[f"decisions, {name}"]) for name in ("read", "hidden"))
        found.append(dict(row) | read | hidden)
    return found


def rates_of(instruction: str, decisions: Sequence[str]) -> dict[str, str]:
    """Share of right decisions with Wilson's interval and suite by suite, and if the first of each suite decides."""
    suites = suites_of(decisions)
    right = [NAMES[int(choice)] == f"libero-{suite}" for choice, suite in zip(decisions, suites, strict=True)]
    own = {suite: [one for one, its in zip(right, suites, strict=True) if its == suite] for suite in SUITES}
    each = " / ".join(f"{100 * sum(one) / len(one):.0f}" for one in own.values())
    return {
        instruction: f"{interval(right)}: {each}",
        f"suites, {instruction}": f"{sum(one[0] for one in own.values())} of {len(SUITES)}",
    }
