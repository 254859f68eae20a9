"""Baseline routers that use no image: chance, the words of the instruction, and the true task."""

from __future__ import annotations

import re
from collections.abc import Sequence

from robogauntlet.adapters.catalog import original
from robogauntlet.policies.contract import Routing
from robogauntlet.suites.episode import content_hash
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError, answer
from robogauntlet_mergevla.spec import ORACLE_ROUTER


class _WithoutPass:
    """A router that needs no pass of the backbone. Only `instruction-match` reads the instruction."""

    def __init__(self, *, sees_instruction: bool = True) -> None:
        self.sees_instruction = sees_instruction

    def passes(self, experts: int) -> int:
        """Backbone passes for one decision."""
        return 0


class RandomRouter(_WithoutPass):
    """Draws a score for each expert, keyed by episode and expert."""

    name = "random"

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order."""
        return [
            answer({expert: _uniform(observation.episode_id, expert) for expert in model.experts})
            for observation in observations
        ]


class InstructionMatchRouter(_WithoutPass):
    """Compares words with the experts' training instructions: the best |A and B| / |A or B| (P. Jaccard, 1901)."""

    name = "instruction-match"

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order; `unknown` is 1 minus the best score."""
        known = {expert: [_words(model.instructions[task]) for task in tasks] for expert, tasks in model.tasks.items()}
        answers = []
        for observation in observations:
            words = _words(observation.instruction) if self.sees_instruction else frozenset()
            scores = {expert: max(_jaccard(words, own) for own in tasks) for expert, tasks in known.items()}
            answers.append(answer(scores, 1.0 - max(scores.values())))
        return answers


class OracleRouter(_WithoutPass):
    """Answers with the true task's expert: any loss of an oracle-routed policy is due to merging, not to routing."""

    name = ORACLE_ROUTER

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order. Raises RoutingError if its task has no expert."""
        for observation in observations:
            if original(observation.task) not in model.expert_of:
                hint = did_you_mean(observation.task, model.expert_of)
                raise RoutingError(
                    f"router 'oracle': expected a task that has an expert, got '{observation.task}'{hint}"
                )
        return [
            answer({expert: float(expert == model.expert_of[original(observation.task)]) for expert in model.experts})
            for observation in observations
        ]


def _uniform(episode_id: str, expert: str) -> float:
    """Return a number in [0, 1), the same on every machine."""
    return int(content_hash({"episode": episode_id, "expert": expert}), 16) / 16**16


def _words(instruction: str) -> frozenset[str]:
    return frozenset(re.findall(r"[a-z0-9]+", instruction.lower()))


def _jaccard(a: frozenset[str], b: frozenset[str]) -> float:
    return len(a & b) / len(a | b) if a | b else 0.0
