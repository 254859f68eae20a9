"""Combinations of axes: which axes matter, how much, and where failures gather."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations as pairs_of
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.analysis.eligible_episodes import EligibleEpisodes, select_eligible
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.clusters import Cluster, failure_clusters
from robogauntlet.results.statistics.rank_agreement import kendall
from robogauntlet.results.statistics.rates import Estimate, clustered_rate
from robogauntlet.results.statistics.sensitivity import Sensitivity, sobol_indices
from robogauntlet.suites.axes import AXES, SEVERITIES
from robogauntlet.suites.designs import DesignEntry
from robogauntlet.suites.episode import CLEAN, Condition, content_hash

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("simulator", "task", "policy_digest", "axis", "severity", "seed", "status")
"""Fields of the record that are needed."""
BINS = SEVERITIES + 1
"""Groups of severities: absent, above 0 and up to 1, ..., above 4 and up to 5."""
LEAST_POINTS = 2
"""Points from which a rate is shown."""
TOO_SMALL = "the differences between points are too small beside chance to be shared out among axes"
"""Why there are no indices where Var f is not shown to be positive."""


@dataclass(frozen=True, slots=True)
class AxisEffect:
    """Success by severity of one axis, whatever the others are."""

    axis: str
    rates: tuple[Estimate | None, ...]
    """By group of severities, see `BINS`; None with too few points."""


@dataclass(frozen=True, slots=True)
class PairEffect:
    """Success by severity of two axes, whatever the others are."""

    axes: tuple[str, str]
    rates: tuple[tuple[float | None, ...], ...]
    """By group of severities of the first axis, then of the second; None without episodes."""
    episodes: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Example:
    """An episode of a failure cluster."""

    task: str
    axis: str
    severity: int
    seed: int


@dataclass(frozen=True, slots=True)
class PolicyCombinations:
    """One policy in one simulator under combinations of axes."""

    policy: str
    simulator: str
    tasks: int
    points: int
    """Different conditions with a verdict."""
    episodes: int
    success: Estimate
    """Over all points; its interval takes the episodes of a point as alike."""
    clean: Estimate | None
    effects: tuple[AxisEffect, ...]
    """In the order of the plan."""
    pair: PairEffect | None
    """The axes of the first cluster of two, or else the two that matter most."""
    sensitivity: Sensitivity | None
    why_no_sensitivity: str
    """Empty if there is one."""
    base_points_left_out: int
    """Base points of the design that the indices leave out, since a start state has no verdict there."""
    start_states_left_out: int
    """Start states that they leave out, since they have no verdict at too many points."""
    clusters: tuple[Cluster, ...]
    """By lift."""
    examples: tuple[Example, ...]
    """For each cluster the mildest failure whose clean episode succeeded, if there is one."""


@dataclass(frozen=True, slots=True)
class IndexAgreement:
    """Whether two simulators agree on which axes matter."""

    policy: str
    one: str
    other: str
    axes: int
    tau: float
    """Kendall's tau-b of the total indices."""
    p_value: float
    """One-sided, against no agreement."""


@dataclass(frozen=True, slots=True)
class Combinations:
    """The combinations of a run."""

    design: str | None
    """Kind of the design; None if the suite lists the combinations."""
    axes: tuple[str, ...]
    highest: float
    """The highest severity of an axis, to a tenth."""
    policies: tuple[PolicyCombinations, ...]
    agreement: tuple[IndexAgreement, ...]


def combined_conditions(document: RunDocument) -> tuple[Condition, ...]:
    """Return the conditions of a run's design, with repetitions, or else the combinations that its plan lists.

    Those of another version that cannot be read are left out.
    """
    if (design := _design(document)) is not None:
        return design.conditions()
    listed = dict.fromkeys(cell.condition for cell in document.plan)
    return tuple(condition for condition in listed if condition.is_combination and _is_readable(condition))


def _design(document: RunDocument) -> DesignEntry | None:
    """The design of a run, if it combines axes."""
    design = document.suite.design
    return None if design is None or design.kind == "one-at-a-time" else design


def _is_readable(condition: Condition) -> bool:
    try:
        return all(part.severity <= SEVERITIES for part in condition.perturbations)
    except ValueError:
        return False


def build_combinations(document: RunDocument, frame: pd.DataFrame) -> Combinations | None:
    """Compute the results of combinations from the rows of a run with the columns `COLUMNS`; None without any."""
    conditions = combined_conditions(document)
    if not any(condition.is_combination for condition in conditions):
        return None
    design = _design(document)
    axes = _axes(design, conditions)
    eligible = select_eligible(document, frame)
    excluded = document.suite.reference_policies
    found = []
    for policy in dict.fromkeys(cell.policy for cell in document.plan if cell.policy not in excluded):
        own = [cell for cell in document.plan if cell.policy == policy]
        for simulator in dict.fromkeys(cell.simulator for cell in own):
            cells = [cell for cell in own if cell.simulator == simulator]
            found.append(_of_policy(policy, simulator, cells, axes, conditions, eligible, design))
    policies = tuple(one for one in found if one is not None)
    highest = round(max(part.severity for condition in conditions for part in condition.perturbations), 1)
    return Combinations(design.kind if design else None, axes, highest, policies, tuple(_agreements(policies)))


def _axes(design: DesignEntry | None, conditions: Sequence[Condition]) -> tuple[str, ...]:
    if design is not None:
        return design.axes
    named = {part.axis for condition in conditions for part in condition.perturbations}
    return (*(axis for axis in AXES if axis in named), *sorted(named - set(AXES)))


def _of_policy(
    policy: str,
    simulator: str,
    cells: Sequence[PlannedCell],
    axes: tuple[str, ...],
    conditions: Sequence[Condition],
    eligible: EligibleEpisodes,
    design: DesignEntry | None,
) -> PolicyCombinations | None:
    """None without a verdict."""
    wanted = set(conditions)
    played = [cell for cell in cells if cell.condition in wanted]
    rows = _of_common_points(eligible.verdicts(played), len({cell.task for cell in played}))
    if not len(rows):
        return None
    levels = {condition: _severities(condition, axes) for condition in wanted}
    severities = np.array(
        [levels[Condition(str(a), int(s))] for a, s in zip(rows["axis"], rows["severity"], strict=True)]
    )
    won = (rows["status"] == str(Status.SUCCESS)).to_numpy(dtype=float)
    seeds = rows["seed"].to_numpy(dtype=np.int64)
    tasks = np.unique(rows["task"].astype(str), return_inverse=True)[1].reshape(-1)
    unit = np.unique(np.column_stack([tasks, seeds]), axis=0, return_inverse=True)[1].reshape(-1)
    generator = np.random.default_rng(int(content_hash(["combinations", policy, simulator]), 16))
    clusters = failure_clusters(severities, won < 0.5, seeds, axes, generator, groups=tasks)
    sensitivity, (points_out, states_out), reason = _sensitivity(played, axes, conditions, eligible, design)
    point = np.unique(severities, axis=0, return_inverse=True)[1].reshape(-1)
    clean = eligible.verdicts([cell for cell in cells if cell.axis == CLEAN])
    clean_won, place = (clean["status"] == str(Status.SUCCESS)).to_numpy(dtype=float), np.arange(len(clean))
    return PolicyCombinations(
        policy=policy,
        simulator=simulator,
        tasks=len({cell.task for cell in played}),
        points=int(point.max()) + 1,
        episodes=len(won),
        success=clustered_rate(won, point, unit),
        clean=clustered_rate(clean_won, 0 * place, place) if len(place) else None,
        effects=tuple(AxisEffect(axis, _rates(severities[:, i], won, point, unit)) for i, axis in enumerate(axes)),
        pair=_pair(axes, severities, won, clusters, sensitivity),
        sensitivity=sensitivity,
        why_no_sensitivity=reason,
        base_points_left_out=points_out,
        start_states_left_out=states_out,
        clusters=clusters,
        examples=tuple(_examples(rows, severities, clean[clean_won > 0], clusters, axes)),
    )


def _examples(
    rows: pd.DataFrame,
    severities: NDArray[np.float64],
    solved: pd.DataFrame,
    clusters: Sequence[Cluster],
    axes: Sequence[str],
) -> Iterator[Example]:
    """The failure with the lowest sum of severities in each cluster; `solved` are the clean successes."""
    numbered = rows.assign(total=severities.sum(axis=1), row=np.arange(len(rows)))
    failures = numbered[rows["status"] == str(Status.FAILURE)].merge(solved[["task", "seed"]], on=["task", "seed"])
    failures = failures.sort_values(["total", "seed", "task"])
    levels = severities[failures["row"]]
    for cluster in clusters:
        inside = [levels[:, axes.index(one.axis)] >= one.threshold for one in cluster.conditions]
        for one in failures[np.logical_and.reduce(inside)][:1].itertuples():
            yield Example(str(one.task), str(one.axis), int(one.severity), int(one.seed))


def _of_common_points(rows: pd.DataFrame, tasks: int) -> pd.DataFrame:
    """The rows at conditions at which every task has a verdict, so that none is compared with another task's."""
    if tasks < 2 or not len(rows):
        return rows
    return rows[rows.groupby(["axis", "severity"], observed=True)["task"].transform("nunique") >= tasks]


def _severities(condition: Condition, axes: Sequence[str]) -> list[float]:
    by_axis = {part.axis: part.severity for part in condition.perturbations}
    return [by_axis.get(axis, 0.0) for axis in axes]


def _rates(
    severities: NDArray[np.float64], won: NDArray[np.float64], point: NDArray[np.intp], unit: NDArray[np.intp]
) -> tuple[Estimate | None, ...]:
    groups = np.ceil(severities).astype(int)
    rates: list[Estimate | None] = []
    for group in range(BINS):
        inside = groups == group
        enough = len(np.unique(point[inside])) >= LEAST_POINTS
        rates.append(clustered_rate(won[inside], point[inside], unit[inside]) if enough else None)
    return tuple(rates)


def _pair(
    axes: tuple[str, ...],
    severities: NDArray[np.float64],
    won: NDArray[np.float64],
    clusters: Sequence[Cluster],
    sensitivity: Sensitivity | None,
) -> PairEffect | None:
    """None with a single axis, or where nothing says which two matter."""
    chosen = next((tuple(c.axis for c in one.conditions) for one in clusters if len(one.conditions) == 2), None)
    if chosen is None and sensitivity is not None and sensitivity.axes and len(axes) > 1:
        ranked = sorted(sensitivity.axes, key=lambda one: -one.total.value)
        chosen = tuple(axis for axis in axes if axis in (ranked[0].axis, ranked[1].axis))
    if chosen is None and len(axes) == 2:
        chosen = axes
    if chosen is None:
        return None
    one, other = (np.ceil(severities[:, axes.index(axis)]).astype(int) for axis in chosen)
    episodes, successes = np.zeros((BINS, BINS), dtype=int), np.zeros((BINS, BINS))
    np.add.at(episodes, (one, other), 1)
    np.add.at(successes, (one, other), won)
    rates = tuple(
        tuple(float(w / n) if n else None for w, n in zip(*rows, strict=True))
        for rows in zip(successes, episodes, strict=True)
    )
    return PairEffect((chosen[0], chosen[1]), rates, tuple(map(tuple, episodes.tolist())))


def _sensitivity(
    cells: Sequence[PlannedCell],
    axes: tuple[str, ...],
    conditions: Sequence[Condition],
    eligible: EligibleEpisodes,
    design: DesignEntry | None,
) -> tuple[Sensitivity | None, tuple[int, int], str]:
    """Sobol' indices, the base points and the start states that they leave out, and the reason if there are none.

    Each task and seed counts as a seed. Episodes that an oracle gate rejects count too, since indices need the same
    seeds at all points.
    """
    if design is None or design.kind != "sobol":
        return None, (0, 0), "indices need a suite with design: {kind: sobol}"
    places = {condition: i for i, condition in enumerate(dict.fromkeys(conditions))}
    units: dict[tuple[str, int], NDArray[np.float64]] = {}
    for cell in cells:
        rows = eligible.rows.of_cell(cell)
        for seed, status in zip(rows["seed"], rows["status"], strict=True):
            column = units.setdefault((cell.task, int(seed)), np.full(len(places), np.nan))
            column[places[cell.condition]] = str(status) == Status.SUCCESS
    order = [places[condition] for condition in conditions]
    outcomes = [column[order].reshape(-1, len(axes) + 2) for _, column in sorted(units.items())]
    kept = _largest_complete(outcomes)
    if kept is None:
        return None, (0, 0), "indices need two base points at which two start states have a verdict at every condition"
    found = sobol_indices(kept, axes)
    left_out = (len(outcomes[0]) - len(kept), len(outcomes) - kept.shape[2])
    return found, left_out, "" if found.axes else TOO_SMALL


def _largest_complete(outcomes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Outcomes without NaN, shape (points, rows, units), of as many episodes as possible; None without two of each.

    `outcomes` has an array (points, rows) for each unit. Units with the most points that have a NaN are left out first.
    """
    units = sorted(outcomes, key=lambda unit: int(np.isnan(unit).any(axis=1).sum()))
    tables = [np.stack(units[:count], axis=2) for count in range(2, len(units) + 1)]
    complete = [table[~np.isnan(table).any(axis=(1, 2))] for table in tables]
    return max((table for table in complete if len(table) > 1), key=np.size, default=None)


def _agreements(policies: Sequence[PolicyCombinations]) -> list[IndexAgreement]:
    totals: dict[str, dict[str, Mapping[str, float]]] = {}
    for one in policies:
        if one.sensitivity is not None and one.sensitivity.axes:
            values = {axis.axis: axis.total.value for axis in one.sensitivity.axes}
            totals.setdefault(one.policy, {})[one.simulator] = values
    found = []
    for policy, by_simulator in totals.items():
        for first, second in pairs_of(by_simulator, 2):
            axes = list(by_simulator[first])
            tau = kendall([by_simulator[first][axis] for axis in axes], [by_simulator[second][axis] for axis in axes])
            if tau is not None and not math.isnan(tau[0]):
                found.append(IndexAgreement(policy, first, second, len(axes), *tau))
    return found


def cluster_failures(found: Combinations | None, rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """Return the rows of a run that are the examples of its failure clusters."""
    policies = () if found is None else found.policies
    wanted = {(one.policy, *astuple(example)) for one in policies for example in one.examples}
    return [row for row in rows if (row.policy, row.task, row.axis, row.severity, row.seed) in wanted]


def is_inside(condition: Condition, cluster: Cluster) -> bool:
    """Whether a condition is of a failure cluster."""
    by_axis = {part.axis: part.severity for part in condition.perturbations}
    return all(by_axis.get(one.axis, 0.0) >= one.threshold for one in cluster.conditions)
