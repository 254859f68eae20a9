"""Successes of robosuite's oracles in each task with each arm, and the largest motion of a step that the arm follows.

The run stays in `runs/bench/robosuite-oracles`, so that a second call plays what is missing.
"""

import pandas as pd

from robogauntlet.adapters.robosuite.arms import ARMS, split_arm
from robogauntlet.adapters.robosuite.simulation import SIMULATOR
from robogauntlet.orchestrator.runs.plan import find_suite
from robogauntlet.results.api import open_run
from robogauntlet.suites.episode import RenderProfile, View
from tests.benchmarks.document import WRITTEN, write_episodes
from tests.benchmarks.shared import run_suite, table_of

FOLDER = WRITTEN / "robosuite-oracles"
FIELDS = ("task", "seed", "status", "steps", "state_hash", "actions_hash", "policy_digest")
SEEDS = 100


def measure() -> list[dict[str, object]]:
    """Play the shipped suite `robosuite` with more seeds; nothing is rendered, as the oracle does not look."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    suite = FOLDER / "suite.yaml"
    shipped = find_suite("robosuite").read_text(encoding="utf-8")
    suite.write_text(shipped.replace("count: 20", f"count: {SEEDS}"), encoding="utf-8")
    run_suite(suite, FOLDER / "run")
    episodes = open_run(FOLDER / "run").episodes(FIELDS)
    write_episodes("robosuite_oracles", episodes, ("task", "seed"))
    rows = rows_of(episodes, {arm: _bounds(arm) for arm in ARMS})
    columns = {
        "task": "{task}",
        "arm": "{arm}",
        "successes": "{successes} of {episodes}",
        "median steps": "{steps:.0f}",
        "horizon": "{horizon}",
        "largest step, mm": "{translation_mm:.1f}",
        "largest turn, rad": "{rotation:.3f}",
    }
    table_of(rows, columns)
    return rows


def rows_of(episodes: pd.DataFrame, bounds: dict[str, tuple[float, float]]) -> list[dict[str, object]]:
    """Return a row for each task; `bounds` has each arm's largest step (mm) and turn (rad)."""
    rows: list[dict[str, object]] = []
    for name, description in SIMULATOR.tasks.items():
        arm = split_arm(name)[1]
        played = episodes[episodes.task == f"robosuite/{name}"]
        solved = played.status == "success"
        translation_mm, rotation = bounds[arm]
        rows.append(
            {
                "task": name,
                "arm": ARMS[arm].title,
                "successes": int(solved.sum()),
                "episodes": len(played),
                "steps": float(played.steps[solved].median()),
                "horizon": description.horizon,
                "translation_mm": translation_mm,
                "rotation": rotation,
            }
        )
    return rows


def _bounds(arm: str) -> tuple[float, float]:
    name = next(task for task in SIMULATOR.tasks if split_arm(task)[1] == arm)
    simulation = SIMULATOR.open(name, View(image_size=32, render_profile=RenderProfile.FAST))
    simulation.close()
    return round(1000.0 * simulation.action_spec.max_translation, 3), simulation.action_spec.max_rotation
