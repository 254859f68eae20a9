"""Selects episodes of a run by policy, task, condition, status and seed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.suites.conditions import condition_patterns
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.selection import match_patterns


@dataclass(frozen=True)
class EpisodeFilter:
    """Selects episodes of a run, all by default."""

    policies: tuple[str, ...] = ()
    """Names, or patterns."""
    tasks: tuple[str, ...] = ()
    """`simulator/task`, or patterns."""
    conditions: tuple[str, ...] = ()
    """`clean`, `noise@3`, `noise` for all severities, or patterns such as `n*@4`."""
    statuses: tuple[str, ...] = ()
    """`success`, `failure` or `error`; all without one."""
    seeds: tuple[int, ...] = ()
    """Seeds; all without one."""

    def select(self, document: RunDocument, rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
        """The selected rows of a run, ordered by task, policy, condition and seed.

        Raises:
            SelectionError: A name or pattern matches nothing in the run.
        """

        def matching(what: str, patterns: Sequence[str], known: Iterable[str]) -> set[str]:
            return match_patterns(what, patterns, list(dict.fromkeys(known)), whole="run")

        policies = matching("policy", self.policies, (cell.policy for cell in document.plan))
        tasks = matching("task", self.tasks, (cell.task for cell in document.plan))
        shown = [pattern for text in self.conditions for pattern in condition_patterns(text)]
        conditions = matching("condition", shown, map(condition_of, document.plan))
        selected = (
            row
            for row in rows
            if row.policy in policies
            and row.task in tasks
            and condition_of(row) in conditions
            and row.status in (self.statuses or (row.status,))
            and row.seed in (self.seeds or (row.seed,))
        )
        return sorted(selected, key=lambda row: (row.task, row.policy, row.axis, row.severity, row.seed))


def condition_of(part: EpisodeResult | PlannedCell) -> str:
    """The condition of an episode or cell, as tables show it."""
    return str(Condition(part.axis, part.severity))
