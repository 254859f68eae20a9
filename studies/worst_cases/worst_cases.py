"""How near the search for worst cases comes to known boundaries of simulated policies: 200 searches for each row."""

from __future__ import annotations

import math

from studies.shared import table_of
from tests.results.statistics.test_worst_case import Policy, run, smallest_found

SEARCHES = 200
BUDGETS = (200, 300, 400)
NEAR = 0.5
"""Severities within which a boundary counts as found."""
BEYOND = 5.5
"""What a boundary beyond the last severity counts as."""
POLICIES = {
    "2, 3": Policy(a=2.0, b=3.0),
    "2, 3; clean 70 %": Policy(clean=0.7, a=2.0, b=3.0),
    "2.5, 3; slow fall": Policy(width=0.7, a=2.5, b=3.0),
    "2.5, >5": Policy(a=2.5, b=12.0),
    "2, 3, 4, >5": Policy(a=2.0, b=3.0, c=4.0, d=20.0),
}
"""Boundaries of the axes alone to the policy."""


def measure() -> list[dict[str, object]]:
    """Shares of searches that find the smallest boundary, and of claims that are confirmed."""
    rows = [_row(name, policy, budget) for name, policy in POLICIES.items() for budget in BUDGETS]
    table_of(
        rows,
        {
            "boundaries alone": "{policy}",
            "smallest": "{smallest:.2f}",
            "episodes": "{budget}",
            "found within half a severity": "{found:.1%}",
            "axes alone within it": "{alone:.1%}",
            "claims confirmed": "{confirmed:.1%}",
            "confirmed wrongly": "{wrong:.1%}",
            "beyond the smallest": "{beyond:.2f}",
        },
    )
    return rows


def _row(name: str, policy: Policy, budget: int) -> dict[str, object]:
    found, alone, confirmed, wrong, beyond, claims = 0, 0, 0, 0, [], 0
    for seed in range(SEARCHES):
        result = run(policy, budget, seed)
        found += abs(smallest_found(result) - policy.smallest()) <= NEAR
        for one in result.axes:
            (axis, _) = one.point[0]
            alone += abs(min(one.boundary.value or BEYOND, BEYOND) - min(policy.alone(axis), BEYOND)) <= NEAR
        breaking = [one for one in (*result.axes, result.combined) if one is not None and one.breaks]
        shown = [one for one in breaking if one.is_confirmed]
        claims += len(breaking)
        confirmed += len(shown)
        wrong += sum(policy.success(one.point) >= policy.clean / 2 for one in shown)
        beyond += [min(one.norm for one in shown) - policy.smallest()] if shown else []
    return {
        "policy": name,
        "budget": budget,
        "smallest": policy.smallest(),
        "found": found / SEARCHES,
        "alone": alone / (SEARCHES * len(policy.thresholds)),
        "confirmed": confirmed / claims,
        "wrong": wrong / max(1, confirmed),
        "beyond": math.fsum(beyond) / len(beyond),
    }
