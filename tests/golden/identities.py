"""Gives kept runs the identities that today's tree plans for the same episodes, whose outcomes stay as they were."""

from __future__ import annotations

from dataclasses import replace

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.record import outcome_row, rows_hash
from tests.golden.kept import BASELINE, PLAYED, KeptRun


def identify(kind: str) -> None:
    """Keep the runs of a kind anew, after a change of policies on which no outcome depends; imported ones stay."""
    for kept in (KeptRun(kind, PLAYED), KeptRun(kind, BASELINE)):
        if not kept.exists:
            continue
        plan, document = make_plan(kept.suite, require_installed=False, start=False), kept.document
        seeds = {row.seed for row in kept.rows}
        planned = [cell.episode(seed) for cell in plan.cells for seed in seeds]
        today = {(episode.policy, episode.pair_id): episode for episode in planned}
        if any((row.policy, row.pair_id) not in today for row in kept.rows):
            continue
        episodes = [today[row.policy, row.pair_id] for row in kept.rows]
        rows = [
            replace(row, episode_id=episode.id, policy_digest=episode.policy_digest)
            for row, episode in zip(kept.rows, episodes, strict=True)
        ]
        digests = {cell.policy: cell.policy_digest for cell in plan.cells}
        cells = tuple(cell.model_copy(update={"policy_digest": digests[cell.policy]}) for cell in document.plan)
        changes = {"suite_hash": plan.suite_hash, "plan": cells}
        if document.rows_hash is not None:
            changes["rows_hash"] = rows_hash(map(outcome_row, rows))
        kept.keep(document.model_copy(update=changes), rows)
