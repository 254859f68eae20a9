"""Checks that rows of others are ones that this program may have written for their run."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from robogauntlet.results.record import FIELDS, EpisodeResult, FailureKind, Status
from robogauntlet.results.run_document import MAX_COUNT, RunDocument
from robogauntlet.suites.episode import LATEST
from robogauntlet.suites.ranges import MAX_STEPS
from robogauntlet.support.json_text import parse_json

LONGEST_TEXT = 100_000
"""Largest length of a text in a row (characters)."""
IDENTITY = FIELDS[: FIELDS.index("status")]
"""Fields that follow from the episode."""


class RowCheck:
    """Checks the rows of one run."""

    def __init__(self, document: RunDocument) -> None:
        """Take the plan and the rules of a run."""
        self._suite = document.suite
        self._cells = {(cell.policy_digest, cell.task, cell.axis, cell.severity) for cell in document.plan}

    def fault(self, row: EpisodeResult) -> str | None:
        """Return what is wrong with a row whose values have the types of their fields, or None."""
        for name in FIELDS:
            if fault := _fault_of(getattr(row, name)):
                return f"{name} {fault}"
        if row.status not in set(Status) or row.failure not in (None, *FailureKind):
            return "its status or failure is unknown"
        if (row.policy_digest, row.task, row.axis, row.severity) not in self._cells:
            return "it is not planned"
        if row.horizon > MAX_STEPS:
            return "horizon is out of bounds"
        if row.routing_scores is not None and not _are_scores(row.routing_scores):
            return "routing_scores are no scores by name"
        return self._fault_of_episode(row)

    def _fault_of_episode(self, row: EpisodeResult) -> str | None:
        try:
            episode = row.episode
        except ValueError:
            return "its protocol is unknown"
        if episode.protocol != self._suite.protocol_with(row.horizon):
            return "its protocol is not that of the suite"
        rest = {name: getattr(row, name) for name in FIELDS if name not in IDENTITY}
        versions = (replace(episode, axis_version=version) for version in range(LATEST, 0, -1))
        known = any(row == EpisodeResult.from_episode(one, **rest) for one in versions)
        return None if known else "its id is not that of its episode"


def _fault_of(value: Any) -> str | None:
    if isinstance(value, int) and not 0 <= value <= MAX_COUNT:
        return "is out of bounds"
    if isinstance(value, float) and not math.isfinite(value):
        return "is no finite number"
    if isinstance(value, str) and (len(value) > LONGEST_TEXT or "\0" in value):
        return "is too long or has the character NUL"
    return None


def _are_scores(text: str) -> bool:
    try:
        scores = parse_json(text)
    except ValueError:
        return False
    return isinstance(scores, dict) and all(
        isinstance(score, int | float) and math.isfinite(score) for score in scores.values()
    )
