"""Rows of experts and merged policies that were never played, for the tests of merging and its report."""

from __future__ import annotations

import json
import math
import random

from robogauntlet.suites.schema import MergingEntry
from tests.results.synthetic import cells, document, row

TASKS = (
    "maniskill/PushCube-v1",
    "maniskill/PullCube-v1",
    "pybullet/PandaPush-v3",
    "pybullet/PandaPickAndPlace-v3",
    "robosuite/Lift",
)
POLICIES = ("experts", "merged-oracle-routed", "merged", "merged-paper")
ROLES = MergingEntry(expert="experts", oracle_routed="merged-oracle-routed", routed=("merged", "merged-paper"))


def plan(policies=POLICIES, tasks=TASKS):
    return cells(policies, tasks)


def routed_document(planned=10, of=None, **changes):
    return document(planned, plan() if of is None else of, **{"merging": ROLES, **changes})


def evidence(inferred, probability=0.9, tasks=TASKS):
    """Routing fields of a row whose router gives the inferred task that probability."""
    rest = (1 - probability) / (len(tasks) - 1)
    scores = {task: round(math.log(probability if task == inferred else rest), 6) for task in tasks}
    return {
        "inferred_task": inferred,
        "routing_scores": json.dumps(scores),
        "unknown_score": 0.5,
        "rejected": False,
        "routing_s": 0.02,
    }


def routed_rows(planned=10, seed=0, right=(0.97, 0.7)):
    """A row per planned episode: experts at 95 %, oracle-routed at 90 %, and two routers with these accuracies."""
    generator = random.Random(seed)
    made = []
    for cell in plan():
        for number in range(planned):
            inferred, chance = cell.task, {"experts": 0.95}.get(cell.policy, 0.9)
            routing = {}
            if cell.policy.startswith("merged") and cell.policy != "merged-oracle-routed":
                rate = right[POLICIES.index(cell.policy) - 2]
                if generator.random() > rate:
                    inferred = TASKS[TASKS.index(cell.task) ^ 1] if cell.task != TASKS[-1] else TASKS[0]
                    chance = 0.1
                routing = evidence(inferred, generator.choice([0.5, 0.8, 0.95]))
                routing["routing_s"] = generator.uniform(0.01, 0.03)
            status = "success" if generator.random() < chance else "failure"
            made.append(row(cell, number, status, **routing))
    return made
