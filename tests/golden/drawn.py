"""Draws the rows of a suite, for kinds whose play takes long or needs an environment that is not here."""

from __future__ import annotations

import random

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.record import EpisodeResult, outcome_row, rows_hash
from robogauntlet.results.run_document import RunDocument, RunStatus
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Cell
from tests.golden.kept import KeptRun
from tests.results.synthetic import row, with_behaviour

SKILL = {"oracle": 0.97, "experts": 0.85, "merged": 0.7, "untrained": 0.05}
"""Success on clean episodes; of other policies none."""
FRAGILE = {"action-delay": 0.2, "object-position": 0.02, "noise": 0.13, "illuminance": 0.1, "camera-orbit": 0.2}
"""What a severity of an axis takes from a rate, as a share."""
KINDS = ("not-reached", "not-grasped", "dropped", "misplaced", "timed-out")
BEGUN = 1_764_400_000.0


def draw(kind: str) -> None:
    """Keep a run of a kind with drawn rows, the same each time."""
    kept = KeptRun(kind)
    plan = make_plan(kept.suite, require_installed=False, start=False)
    generator = random.Random(kind)
    played = [_row(cell, seed, generator) for cell in plan.cells for seed in plan.suite.seeds]
    rows = with_behaviour(played, lambda result: KINDS[int(result.pair_id, 16) % len(KINDS)])
    cards = catalog.task_descriptions()
    tasks = plan.suite.tasks
    document = RunDocument(
        run_id=f"golden-{kind}",
        suite=plan.suite,
        suite_hash=plan.suite_hash,
        suite_text=plan.text,
        suite_path=kept.suite.name,
        started_at=BEGUN,
        finished_at=BEGUN + 900,
        elapsed_s=900.0,
        status=RunStatus.COMPLETE,
        plan=plan.planned_cells(),
        unsupported=plan.unsupported,
        warnings=plan.warnings,
        instructions={task: cards[task].instruction for task in tasks},
        robots={task: robot for task in tasks if (robot := cards[task].robot)},
        workers=dict.fromkeys(plan.simulators, 1),
        render_devices=dict.fromkeys(plan.simulators, "llvmpipe"),
        rows_hash=rows_hash(map(outcome_row, rows)),
    )
    kept.keep(document, rows)


def _row(cell: Cell, seed: int, generator: random.Random) -> EpisodeResult:
    chance = SKILL.get(cell.policy, 0.0)
    for part in cell.condition.perturbations:
        chance *= max(0.0, 1 - FRAGILE.get(part.axis, 0.0) * part.severity)
    if cell.condition.axis in ("blind", "wrong-goal"):
        chance /= 4
    won, horizon = generator.random() < chance, cell.protocol.horizon
    steps = generator.randrange(horizon // 3, horizon) if won else horizon
    changes: dict[str, float] = {
        "steps": steps,
        "queries": steps // cell.protocol.replan_every + 1,
        "wall_s": steps / 20,
    }
    if cell.condition.is_on_scale:
        axis, measured = AXES[cell.condition.axis], generator.uniform(0.9, 1.1)
        if axis.ordered:
            changes["delivered"] = round(axis.value(cell.condition.severity) * measured, 6)
    return row(cell, seed, "success" if won else "failure", **changes)
