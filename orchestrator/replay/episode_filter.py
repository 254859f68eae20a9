"""Selects episodes of a run by policy, task, condition, status and seed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import heappush, heappushpop

from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.suites.conditions import condition_patterns
from robogauntlet.suites.episode import Condition, content_hash
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
    limit: int | None = None
    """Maximum per task, selected by the hashes of the ids. A larger limit adds to the selection of a smaller one."""

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
        drawn: dict[str, list[tuple[int, str, EpisodeResult]]] = {}
        for row in rows:
            is_named = row.policy in policies and row.task in tasks and condition_of(row) in conditions
            if not is_named or row.status not in (self.statuses or (row.status,)):
                continue
            if row.seed not in (self.seeds or (row.seed,)):
                continue
            heap = drawn.setdefault(row.task, [])
            entry = (-int(content_hash(row.episode_id), 16), row.episode_id, row)
            (heappush if self.limit is None or len(heap) < self.limit else heappushpop)(heap, entry)
        selected = (row for heap in drawn.values() for _, _, row in heap)
        return sorted(selected, key=lambda row: (row.task, row.policy, row.axis, row.severity, row.seed))


def condition_of(part: EpisodeResult | PlannedCell) -> str:
    """The condition of an episode or cell, as tables show it."""
    return str(Condition(part.axis, part.severity))
