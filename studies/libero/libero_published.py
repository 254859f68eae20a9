"""Which differences between published results on LIBERO 500 episodes a side can show.

`python -m studies libero --measure libero_published` compares every two of `published.yaml` in each suite by Fisher's
test on the numbers of successes that their percentages mean. Papers print no outcomes by episode, so nothing is paired.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.sample_size import separate_difference
from robogauntlet.results.statistics.separate_trials import Separate, fisher
from studies.libero.libero_experts import SUITES
from studies.shared import table_of

EPISODES, BEST = 500, 10
COLUMNS = {
    "suite": "{suite}",
    "results": "{results}",
    "best": "{best:.1f} %",
    "differences shown": "{shown} of {pairs}",
    f"of the best {BEST}": "{shown_of_best} of {pairs_of_best}",
    "not shown to be worse than the best": "{like_the_best}",
    "smallest drop from the best that is shown (80 % power)": "{smallest:.1f} points",
}


def measure() -> list[dict[str, object]]:
    """A row for each suite."""
    rows = rows_of()
    table_of(rows, COLUMNS)
    return rows


def counted(_: list[dict[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the published results."""
    return rows_of()


def rows_of() -> list[dict[str, object]]:
    """Of all pairs of results in a suite, and of its best ten, those whose difference is shown at 5 %."""
    published = yaml.safe_load(Path(__file__).with_name("published.yaml").read_text(encoding="utf-8"))
    rows = []
    for column, title in enumerate(SUITES.values()):
        won = sorted((round(EPISODES * one["success"][column] / 100) for one in published), reverse=True)
        of_all, of_best = (np.array([_differ(*pair) for pair in combinations(some, 2)]) for some in (won, won[:BEST]))
        smallest = separate_difference(won[0] / EPISODES, EPISODES)
        assert smallest is not None
        rows.append(
            {
                "suite": title,
                "results": len(won),
                "best": 100 * won[0] / EPISODES,
                "shown": int(of_all.sum()),
                "pairs": len(of_all),
                "shown_of_best": int(of_best.sum()),
                "pairs_of_best": len(of_best),
                "like_the_best": sum(not _differ(won[0], other) for other in won[1:]),
                "smallest": 100 * smallest,
            }
        )
    return rows


def _differ(first: int, second: int) -> bool:
    return fisher([Separate(first, EPISODES, second, EPISODES)]) <= ALPHA
