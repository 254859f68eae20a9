"""Stops a comparison when it is decided, and spends what that saves on the others. Pure: from outcomes to work.

Conditions are played in rounds of seeds. After a round each condition's evidence is looked at: the e-process of the
pairs of baseline and other policy, over all tasks (`results.statistics.sequential.paired_evidence`). It may be looked
at as often as one likes, so a condition that is decided can stop, and no true null hypothesis is decided against with a
chance above alpha. The episodes saved go to further rounds of the undecided conditions, until the budget, which is what
the suite would have played without stopping, is spent. The clean condition goes on as long as any other does, for all
are set beside it; controls never get more than the suite's seeds.

Decisions are made between rounds and from outcomes alone, so they depend neither on the number of workers nor on the
order in which episodes came back, and a run that was stopped goes on with the same ones.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from orchestrator.plan import Plan
from results.record import Status
from results.run import Decided
from results.statistics.pairs import Pairs
from results.statistics.sequential import is_decided, paired_evidence
from suites.schema import AdaptiveEntry, CompareEntry, Seeds
from suites.vocabulary import CONTROLS, Cell, Condition, content_hash

Key = tuple[str, str, str, int]
"""Policy digest, task, axis, severity."""
Outcomes = Mapping[Key, Mapping[int, str]]
"""Status of each seed of a cell that has been played."""
Work = list[tuple[Cell, Sequence[int]]]


@dataclass
class Progression:
    """How far an adaptive run has come."""

    work: Work = field(default_factory=list)
    """What the round under way still lacks; nothing once the run is over."""
    planned: dict[Cell, int] = field(default_factory=dict)
    """Seeds asked for so far."""
    decided: list[Decided] = field(default_factory=list)


def key_of(cell: Cell) -> Key:
    """Under which a cell's outcomes are stored."""
    return cell.policy_digest, cell.task, cell.condition.axis, cell.condition.severity


def missing(plan: Plan, outcomes: Outcomes, skipped: Collection[str] = ()) -> Progression:
    """What a plan still lacks: of an adaptive suite in the round under way, else of everything.

    Args:
        plan: The suite, resolved.
        outcomes: Of what has been played.
        skipped: Simulators that cannot run here, beside those that are not installed.
    """
    suite, sides = plan.suite, plan.suite.comparison
    if suite.adaptive is None or sides is None:
        return Progression(plan.missing(outcomes), dict.fromkeys(plan.cells, suite.seeds.count))
    cells = [cell for cell in plan.cells if cell.simulator not in {*plan.unavailable, *skipped}]
    return progression(cells, suite.seeds, suite.adaptive, sides, outcomes)


def progression(
    cells: Sequence[Cell], seeds: Seeds, rule: AdaptiveEntry, sides: CompareEntry, outcomes: Outcomes
) -> Progression:
    """Replay the rounds that are complete, and say what the next one lacks.

    Args:
        cells: All of the suite.
        seeds: The first, and how many each condition would have had without stopping.
        rule: When to stop.
        sides: Whom to compare.
        outcomes: Of what has been played.
    """
    found = Progression(planned=dict.fromkeys(cells, 0))
    budget = len(cells) * seeds.count
    undecided = list(dict.fromkeys(cell.condition for cell in cells))
    first, own, end = seeds.start, seeds.start + seeds.count, seeds.start + rule.most
    while first < end:
        active = [cell for cell in cells if cell.condition in _played(undecided, extra=first >= own)]
        size = min(rule.round, (own if first < own else end) - first, budget // max(len(active), 1))
        if not active or not size:
            break
        block = range(first, first + size)
        for cell in active:
            found.planned[cell] += size
        budget -= size * len(active)
        missing = [(cell, [s for s in block if s not in outcomes.get(key_of(cell), {})]) for cell in active]
        found.work = _in_drawn_order([(cell, lacking) for cell, lacking in missing if lacking], first)
        if found.work:
            break
        for condition in [condition for condition in undecided if condition != Condition()]:
            decisions = _decisions(cells, condition, sides, rule, outcomes, range(seeds.start, block.stop))
            if decisions is not None:
                found.decided += decisions
                undecided.remove(condition)
        first += size
    return found


def _played(undecided: Sequence[Condition], *, extra: bool) -> Sequence[Condition]:
    """Conditions of a round; none if there is nothing to be set beside the clean one."""
    wanted = [condition for condition in undecided if not (extra and condition.axis in CONTROLS)]
    return wanted if any(condition != Condition() for condition in wanted) else ()


def _in_drawn_order(work: Work, first: int) -> Work:
    """Work in an order that depends on the round alone, so that an early end favours no task."""
    order = np.random.default_rng(int(content_hash(["round", first]), 16)).permutation(len(work))
    return [work[place] for place in order]


def _decisions(
    cells: Sequence[Cell],
    condition: Condition,
    sides: CompareEntry,
    rule: AdaptiveEntry,
    outcomes: Outcomes,
    judged: range,
) -> list[Decided] | None:
    """One per other policy if all of them are decided against the baseline by the judged seeds, else None."""
    own = {(cell.policy, cell.task): cell for cell in cells if cell.condition == condition}
    tasks = [task for policy, task in own if policy == sides.baseline]
    found = []
    for other in sides.others:
        won = _pairs(
            [(own[sides.baseline, task], own[other, task]) for task in tasks if (other, task) in own],
            outcomes,
            judged,
        )
        if not is_decided(won, rule.alpha):
            return None
        found.append(
            Decided(
                policy=other,
                axis=condition.axis,
                severity=condition.severity,
                pairs=won.trials,
                seeds=len(judged),
                evidence=paired_evidence(won),
            )
        )
    return found


def _pairs(cells: Sequence[tuple[Cell, Cell]], outcomes: Outcomes, judged: range) -> Pairs:
    counts = [0, 0, 0, 0]
    verdicts = (str(Status.SUCCESS), str(Status.FAILURE))
    for first, second in cells:
        ours, theirs = outcomes.get(key_of(first), {}), outcomes.get(key_of(second), {})
        for seed in judged:
            if ours.get(seed) in verdicts and theirs.get(seed) in verdicts:
                counts[2 * (ours[seed] != verdicts[0]) + (theirs[seed] != verdicts[0])] += 1
    return Pairs(*counts)
