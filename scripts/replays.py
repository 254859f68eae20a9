"""Records the actions that the `replay` policy plays: those of each oracle on one training seed, without noise.

Usage: python scripts/replays.py [FILE]   (default policies/open_loop_replays.json)
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import FloatArray, Simulation
from robogauntlet.orchestrator.demonstrations.collect import DEFAULT_VIEW, FIRST_SEED
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.trajectory_recorder import TrajectoryRecorder
from robogauntlet.policies.open_loop_replay import FILE
from robogauntlet.suites.episode import Episode, Protocol

ROUNDED = 5
"""Decimals that are kept: a hundredth of a millimetre."""


def demonstration(runner: EpisodeRunner, task: str, horizon: int) -> tuple[str, FloatArray]:
    """Return the status of the oracle's episode, and its actions (steps, 7)."""
    episode = Episode("oracle", "oracle", task, FIRST_SEED, Protocol(horizon, 1, DEFAULT_VIEW))
    records: list[TrajectoryRecorder] = []

    def record(simulation: Simulation) -> Simulation:
        records.append(TrajectoryRecorder(simulation))
        return records[-1]

    result = runner.play_one(episode, wrap=record)
    return result.status, records[-1].recording().actions


def main() -> None:
    """Play every task of the real simulators once."""
    simulators = [simulator for simulator in catalog.simulators().values() if not simulator.internal]
    for simulator in simulators:  # set before any is imported: they import each other's renderers
        for name, value in simulator.environment.items():
            os.environ.setdefault(name, value)
    runner = EpisodeRunner({"oracle": PolicySource("oracle")})
    document = {}
    for simulator in simulators:
        for name, description in simulator.tasks.items():
            if description.arms != 1:  # the policy `replay` has one arm
                continue
            status, actions = demonstration(runner, f"{simulator.name}/{name}", description.horizon)
            document[f"{simulator.name}/{name}"] = {"seed": FIRST_SEED, "actions": actions.round(ROUNDED).tolist()}
            print(f"{simulator.name}/{name}: {status}, {len(actions)} steps")
    runner.close()
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    file.write_text(json.dumps(document) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
