"""How policies fail: counts of the kinds of failures, and their shares, by condition."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.record import FailureKind, Status, known_kind
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.rates import Interval, clustered_rate, wilson_interval
from robogauntlet.suites.episode import AT, CLEAN, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("simulator", "task", "policy", "policy_digest", "axis", "severity", "seed", "status", "failure")
"""Fields of the record that are needed."""
OTHER = "other"
"""Failures without a kind, or of a kind that this version does not know."""
KINDS = (*map(str, FailureKind), OTHER)
OUTCOMES = (str(Status.SUCCESS), *KINDS, str(Status.ERROR))
"""What an episode can come to, in the order of plots and tables."""
COMBINATIONS = "combinations"
"""Name of the group of all combinations of axes."""


@dataclass(frozen=True, slots=True)
class KindCount:
    """Failures of one kind."""

    kind: str
    """One of `KINDS`."""
    failures: int
    share: float
    """Of all failures of the group."""
    interval: Interval | None
    """Wilson interval of the share, 95 %, for as many failures as are equally informative, see `clustered_rate`:
    failures from one start state (task and seed), or at one point of a design, are alike."""


@dataclass(frozen=True, slots=True)
class FailureGroup:
    """Episodes of one policy in one simulator, and how they failed."""

    name: str
    """Axis, `clean`, `combinations`, an axis of combinations with its lowest severity, a task, or `all`."""
    successes: int
    failures: int
    errors: int
    kinds: tuple[KindCount, ...]
    """Those that occur, in the order of `KINDS`."""

    @property
    def episodes(self) -> int:
        """All episodes with a row."""
        return self.successes + self.failures + self.errors

    @property
    def most(self) -> KindCount | None:
        """The most frequent known kind; None if no failure has one."""
        known = [one for one in self.kinds if one.kind != OTHER]
        return max(known, key=lambda one: one.failures, default=None)

    def count(self, outcome: str) -> int:
        """Number of episodes with one of `OUTCOMES`."""
        found = {one.kind: one.failures for one in self.kinds}
        return {OUTCOMES[0]: self.successes, OUTCOMES[-1]: self.errors, **found}.get(outcome, 0)


@dataclass(frozen=True, slots=True)
class PolicyFailures:
    """One policy in one simulator."""

    policy: str
    simulator: str
    total: FailureGroup
    groups: tuple[FailureGroup, ...]
    """By condition: clean, each axis with all its severities, and combinations; by task if all episodes are clean."""


@dataclass(frozen=True, slots=True)
class Failures:
    """How the policies of a run fail, without its oracle gate and no-skill baselines."""

    by_task: bool
    """Whether groups are tasks."""
    policies: tuple[PolicyFailures, ...]

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Those of `OUTCOMES` that occur."""
        return tuple(name for name in OUTCOMES if any(one.total.count(name) for one in self.policies))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Those of `KINDS` that occur."""
        return tuple(name for name in self.outcomes if name in KINDS)


def build_failures(document: RunDocument, frame: pd.DataFrame) -> Failures | None:
    """Count the kinds of failures of a run from its rows with the columns `COLUMNS`; None if no failure has a kind.

    All episodes but those of controls count: an oracle gate rejects none of them.
    """
    frame = frame[~frame["axis"].isin(list(CONTROLS))]
    fields = [name for name in COLUMNS if name != "seed"]
    counts = frame[fields].groupby(fields, sort=False, observed=True, dropna=False).size().reset_index(name="n")
    counts[fields] = counts[fields].astype(object)
    counts["outcome"] = [_outcome(*row) for row in zip(counts["status"], counts["failure"], strict=True)]
    if not counts["outcome"].isin(list(FailureKind)).any():
        return None
    failed = _failed(frame)
    names = {cell.policy_digest: cell.policy for cell in document.plan}
    for table in (counts, failed):
        policies = zip(table["policy_digest"], table["policy"], strict=True)
        table["policy"] = [names.get(digest, name) for digest, name in policies]
    conditions = _conditions(document, counts["axis"])
    by_task = list(conditions) == [CLEAN]
    left_out = document.suite.reference_policies
    found = []
    for policy in dict.fromkeys([*names.values(), *counts["policy"]]):
        own = counts[counts["policy"] == policy]
        for simulator in dict.fromkeys(own["simulator"]):
            here = own[own["simulator"] == simulator]
            failures = failed[(failed["policy"] == policy) & (failed["simulator"] == simulator)]
            column = "task" if by_task else "axis"
            parts = {task: [task] for task in here["task"]} if by_task else conditions
            groups = [
                _group(name, here[chosen], failures[failures[column].isin(values)])
                for name, values in parts.items()
                if (chosen := here[column].isin(values)).any()
            ]
            found.append(PolicyFailures(str(policy), str(simulator), _group("all", here, failures), tuple(groups)))
    shown = [one for one in found if one.policy not in left_out] or found
    return Failures(by_task, tuple(shown))


def _outcome(status: str, failure: object) -> str:
    return str(known_kind(failure) or OTHER) if status == Status.FAILURE else str(status)


def _failed(frame: pd.DataFrame) -> pd.DataFrame:
    """The failures with their kind, and the numbers of their start state (`unit`) and point of a design (`point`).

    `combined` is whether the point is one of a design.
    """
    rows = frame.loc[(frame["status"] == Status.FAILURE).to_numpy(), list(COLUMNS)].astype(object)
    points = rows.groupby(["axis", "severity"]).ngroup()
    combined = rows["axis"].str.contains(AT, regex=False).astype(bool)
    return rows.assign(
        kind=[_outcome(*row) for row in zip(rows["status"], rows["failure"], strict=True)],
        unit=rows.groupby(["task", "seed"]).ngroup(),
        combined=combined,
        # The severities of an axis are chosen, not drawn: there each failure is its own point.
        point=points.where(combined, len(rows) + np.arange(len(rows))),
    )


def _group(name: str, counts: pd.DataFrame, failed: pd.DataFrame) -> FailureGroup:
    numbers = {str(outcome): int(n) for outcome, n in counts.groupby("outcome")["n"].sum().items()}
    kinds = tuple(_kind_count(kind, failed) for kind in KINDS if kind in numbers)
    successes, failures = numbers.get(OUTCOMES[0], 0), len(failed)
    return FailureGroup(name, successes, failures, sum(numbers.values()) - successes - failures, kinds)


def _kind_count(kind: str, failed: pd.DataFrame) -> KindCount:
    of_kind = (failed["kind"] == kind).to_numpy(float)
    number, failures = int(of_kind.sum()), len(failed)
    if failed["unit"].is_unique:
        return KindCount(kind, number, number / failures, wilson_interval(number, failures))
    if number == failures:  # Nothing tells how alike failures of one start state are: they count as one.
        alike = max(failed["unit"].nunique(), failed.loc[failed["combined"], "point"].nunique())
        return KindCount(kind, number, 1.0, wilson_interval(alike, alike))
    estimate = clustered_rate(of_kind, failed["point"].to_numpy(), failed["unit"].to_numpy())
    return KindCount(kind, number, number / failures, estimate.interval)


def _conditions(document: RunDocument, axes: Iterable[str]) -> Mapping[str, Sequence[str]]:
    """Name of each group of conditions to the values of the column `axis` that belong to it.

    Clean comes first, then axes in the order of the plan with all their severities, fractional ones too, and
    combinations: all of them together, and for each axis those at which it is at half of its highest severity or above.
    """
    present = set(axes)
    order = dict.fromkeys([CLEAN, *(cell.axis for cell in document.plan), *sorted(present)])
    conditions = {axis: Condition(axis, 1) for axis in order if axis in present}
    groups: dict[str, list[str]] = {}
    combined = []
    for axis, condition in conditions.items():
        parts = [name for name, _ in _severities(condition)] if condition.is_combination else [axis]
        if len(parts) == 1:
            groups.setdefault(parts[0], []).append(axis)
        else:
            combined.append(axis)
    if not combined:
        return groups
    groups[COMBINATIONS] = combined
    severities: dict[str, dict[str, float]] = {}
    for axis in combined:
        for name, severity in _severities(conditions[axis]):
            severities.setdefault(name, {})[axis] = severity
    for name, of_axis in sorted(severities.items()):
        half = round(max(of_axis.values()) / 2, 1)
        chosen = [axis for axis, severity in of_axis.items() if severity >= half]
        if len(chosen) < len(combined):
            groups[f"{name} {half:g} or more"] = chosen
    return groups


def _severities(condition: Condition) -> Iterator[tuple[str, float]]:
    try:
        yield from ((part.axis, part.severity) for part in condition.perturbations)
    except ValueError:  # of another version
        return
