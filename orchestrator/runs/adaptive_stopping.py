"""Stops decided comparisons early and spends the saved episodes on the undecided ones. Pure: from outcomes to work.

Conditions are played in rounds of seeds. After a round, each condition's evidence is evaluated: the e-process of the
pairs of baseline and other policy, over all tasks (`results.statistics.sequential.paired_evidence`). It is valid at any
number of evaluations, so a decided condition can stop, and the probability that a true null hypothesis is rejected
stays below alpha. The saved episodes go to further rounds of the undecided conditions, until the budget is spent, which
is the number of episodes of the suite without stopping. The clean condition is played as long as any other, because all
are compared with it; controls never get more than the suite's seeds.

Decisions are made between rounds and from outcomes alone. They depend neither on the number of workers nor on the order
of the results, and a run that is continued repeats them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import Decided
from robogauntlet.results.statistics.pairs import Pairs
from robogauntlet.results.statistics.sequential import is_decided, paired_evidence
from robogauntlet.suites.episode import CONTROLS, Cell, Condition, content_hash
from robogauntlet.suites.schema import AdaptiveEntry, CompareEntry, Seeds

Key = tuple[str, str, str, int]
"""Policy digest, task, axis, severity."""
Outcomes = Mapping[Key, Mapping[int, str]]
"""Status of each seed of a cell that has been played."""
Work = list[tuple[Cell, Sequence[int]]]


@dataclass
class Progression:
    """The state of an adaptive run."""

    work: Work = field(default_factory=list)
    """Remaining work of the current round; empty at the end of the run."""
    planned: dict[Cell, int] = field(default_factory=dict)
    """Seeds planned so far."""
    decided: list[Decided] = field(default_factory=list)


def key_of(cell: Cell) -> Key:
    """The key of a cell's outcomes."""
    return cell.policy_digest, cell.task, cell.condition.axis, cell.condition.severity


def progression(
    cells: Sequence[Cell], seeds: Seeds, rule: AdaptiveEntry, sides: CompareEntry, outcomes: Outcomes
) -> Progression:
    """Replay the complete rounds of a suite's cells, and determine the remaining work of the next one."""
    state = Progression(planned=dict.fromkeys(cells, 0))
    budget = len(cells) * seeds.count
    undecided = list(dict.fromkeys(cell.condition for cell in cells))
    first, extra_begin, end = seeds.start, seeds.start + seeds.count, seeds.start + rule.max_seeds
    while first < end:
        active = [cell for cell in cells if cell.condition in _played(undecided, extra=first >= extra_begin)]
        size = min(rule.round, (extra_begin if first < extra_begin else end) - first, budget // max(len(active), 1))
        if not active or not size:
            break
        block = range(first, first + size)
        for cell in active:
            state.planned[cell] += size
        budget -= size * len(active)
        missing = [(cell, [s for s in block if s not in outcomes.get(key_of(cell), {})]) for cell in active]
        work = [(cell, lacking) for cell, lacking in missing if lacking]
        # The random order depends on the round alone. It keeps an early end from favouring some tasks.
        order = np.random.default_rng(int(content_hash(["round", first]), 16)).permutation(len(work))
        state.work = [work[place] for place in order]
        if state.work:
            break
        for condition in [condition for condition in undecided if condition != Condition()]:
            decisions = _decisions(cells, condition, sides, rule, outcomes, range(seeds.start, block.stop))
            if decisions is not None:
                state.decided += decisions
                undecided.remove(condition)
        first += size
    return state


def _played(undecided: Sequence[Condition], *, extra: bool) -> Sequence[Condition]:
    """Conditions of a round; none if no condition is left to compare with the clean one."""
    wanted = [condition for condition in undecided if not (extra and condition.axis in CONTROLS)]
    return wanted if any(condition != Condition() for condition in wanted) else ()


def _decisions(
    cells: Sequence[Cell],
    condition: Condition,
    sides: CompareEntry,
    rule: AdaptiveEntry,
    outcomes: Outcomes,
    seeds: range,
) -> list[Decided] | None:
    """A decision per other policy, or None unless these seeds decide all comparisons with the baseline."""
    cell_of = {(cell.policy, cell.task): cell for cell in cells if cell.condition == condition}
    tasks = [task for policy, task in cell_of if policy == sides.baseline]
    decisions = []
    for other in sides.others:
        compared = [(cell_of[sides.baseline, task], cell_of[other, task]) for task in tasks if (other, task) in cell_of]
        pairs = _pairs(compared, outcomes, seeds)
        if not is_decided(pairs, rule.alpha):
            return None
        decisions.append(
            Decided(
                policy=other,
                axis=condition.axis,
                severity=condition.severity,
                pairs=pairs.trials,
                seeds=len(seeds),
                evidence=paired_evidence(pairs),
            )
        )
    return decisions


def _pairs(cells: Sequence[tuple[Cell, Cell]], outcomes: Outcomes, seeds: range) -> Pairs:
    counts = [0, 0, 0, 0]
    verdicts = (str(Status.SUCCESS), str(Status.FAILURE))
    for first, second in cells:
        ours, theirs = outcomes.get(key_of(first), {}), outcomes.get(key_of(second), {})
        for seed in seeds:
            if ours.get(seed) in verdicts and theirs.get(seed) in verdicts:
                counts[2 * (ours[seed] != verdicts[0]) + (theirs[seed] != verdicts[0])] += 1
    return Pairs(*counts)
