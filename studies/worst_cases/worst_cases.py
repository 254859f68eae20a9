"""How often the search for worst cases is right about simulated policies of known boundaries: 1,000 searches a row."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.results.statistics.boundary import Boundary
from robogauntlet.results.statistics.worst_case import LARGEST, Disturbance, Point
from studies.percent import few
from studies.shared import table_of
from tests.results.statistics.test_worst_case import Policy, run, smallest_found

SEARCHES = few(1000)
NEAR = 0.5
"""Severities within which a boundary counts as found."""


class Plateau(Policy):
    """Success falls no lower than 40 % of the clean rate, just below the half that counts as broken."""

    def success(self, point: Point) -> float:
        """Success at a point, whose boundary is that of a policy whose success falls to 0."""
        share = super().success(point) / self.clean
        return self.clean * (share if share > 0.5 else 0.4 + 0.2 * share)


POLICIES = {
    "2, 3": (Policy(a=2.0, b=3.0), (200, 400)),
    "2, 3; clean 70 %": (Policy(clean=0.7, a=2.0, b=3.0), (200,)),
    "2.5, 3; slow fall": (Policy(width=0.7, a=2.5, b=3.0), (200,)),
    "2, 3, 4, >5": (Policy(a=2.0, b=3.0, c=4.0, d=20.0), (200, 400)),
    "2, 3; falls to 40 % of clean": (Plateau(a=2.0, b=3.0), (200,)),
}
"""Boundaries of the axes alone to the policy, and budgets."""


def measure() -> list[dict[str, object]]:
    """Shares of searches that find the smallest boundary, and of claims that are confirmed."""
    rows = [_row(name, policy, budget) for name, (policy, budgets) in POLICIES.items() for budget in budgets]
    table_of(
        rows,
        {
            "boundaries alone": "{policy}",
            "smallest": "{smallest:.2f}",
            "episodes": "{budget}",
            "found within half a severity": "{found:.1%}",
            "80 % intervals with the boundary": "{inside:.1%}",
            "proposed and confirmed": "{confirmed:.1%}",
            "with too few episodes": "{few:.1%}",
            "confirmed wrongly": "{wrong:.1%}",
            "beyond the smallest": "{beyond:.2f}",
        },
    )
    return rows


def _row(name: str, policy: Policy, budget: int) -> dict[str, object]:
    found, inside, beyond = [], [], []
    breaking: list[Disturbance] = []
    for seed in range(SEARCHES):
        result = run(policy, budget, seed)
        found.append(abs(smallest_found(result) - policy.smallest()) <= NEAR)
        inside += [_is_inside(one.boundary, policy.alone(one.point[0][0])) for one in result.axes]
        own = [one for one in (*result.axes, result.combined) if one is not None and one.breaks]
        breaking += own
        beyond += [min(norms) - policy.smallest()] if (norms := [one.norm for one in own if one.is_confirmed]) else []
    print(f"{name}, {budget} episodes", flush=True)
    proposed = [one.is_confirmed for one in breaking if one.is_proposed]
    shown = [policy.success(one.point) >= policy.clean / 2 for one in breaking if one.is_confirmed]
    return {
        "policy": name,
        "budget": budget,
        "smallest": policy.smallest(),
        "found": float(np.mean(found)),
        "inside": float(np.mean(inside)),
        "confirmed": float(np.mean(proposed)),
        "few": 1 - len(proposed) / len(breaking),
        "wrong": float(np.mean(shown)),
        "beyond": float(np.mean(beyond)),
    }


def _is_inside(boundary: Boundary, true: float) -> bool:
    """Whether an interval has the true boundary; None stands for beyond the largest severity."""
    return (LARGEST if boundary.low is None else boundary.low) <= true <= (boundary.high or math.inf)
