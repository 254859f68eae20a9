"""What merging and quantising cost under perturbations, for the zoo's experts and robust ones: tests of equivalence.

`ROBUST=FOLDER python -m studies robust_experts --measure merging_under_shift` reads the runs of
`studies/robust_experts/robust_experts.sh`, as `robust_experts` does, which keeps their episodes.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd

from robogauntlet.results.analysis.condition_comparison import Equivalence, equivalence
from robogauntlet.results.report.formatting import points
from robogauntlet.results.statistics.aggregate import mean_of_levels
from studies.robust_experts.robust_experts import EXPERTS, SEVERITIES, paired, played
from studies.shared import table_of

SETTINGS = {"zoo's, six tasks": ("zoo", 6), "robust, six tasks": ("robust", 6), "zoo's, nine tasks": ("zoo", 9)}
"""To the family, and its number of tasks: those of the robust experts, or all."""
MADE_OF_EXPERTS = ("merged", "unmerged-int4")
WHERE = {"clean": (0,), **{f"severity {one}": (one,) for one in SEVERITIES}, "both severities": SEVERITIES}
MARGIN = 0.05


def measure() -> list[dict[str, object]]:
    """A row for each policy and group of levels."""
    rows = rows_of(played())
    columns = {"experts": "{experts}", "policy": "{policy}", "conditions": "{where}", "pairs": "{pairs}"}
    columns |= {"experts' success": "{baseline:.1%}", "policy's": "{rate:.1%}", "lost (points) [90 %]": "{lost}"}
    table_of(rows, columns | {"differ by less than 5 points": "{shown}"})
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Loss over the levels of each group, with the interval and test of reports; `frame` as of `robust_experts`."""
    rows = []
    shared = frame.task.isin(frame.task[frame.family == "robust"])
    for (setting, (family, tasks)), policy, (where, severities) in product(
        SETTINGS.items(), MADE_OF_EXPERTS, WHERE.items()
    ):
        chosen = (frame.family == family) & frame.severity.isin(severities) & (shared | (tasks == 9))
        strata = paired(frame[chosen], (EXPERTS, policy))
        found = equivalence(policy, strata, MARGIN)
        assert found is not None
        rows.append({"experts": setting, "policy": policy, "where": where, **_row(found, strata)})
    return rows


def _row(found: Equivalence, strata: list[np.ndarray]) -> dict[str, object]:
    sides = (mean_of_levels([np.hsplit(one, 2)[side] for one in strata]) for side in (0, 1))
    baseline, rate = (side.value for side in sides if side)
    shown = "shown" if found.is_shown else "not shown"
    return {"pairs": found.pairs, "baseline": baseline, "rate": rate, "lost": points(found.loss), "shown": shown}
