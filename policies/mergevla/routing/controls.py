"""Routers that look at no image: between them lies whatever looking is worth."""

from __future__ import annotations

import re
from collections.abc import Sequence

from policies.mergevla.routing.contract import Candidates, Routed, RoutingError, Sighting, answer
from suites.plugins import nearest
from suites.vocabulary import content_hash


class RandomRouter:
    """Draws a score for each expert, keyed by the episode and the expert alone."""

    name = "random"

    def __init__(self, *, sees_instruction: bool = True) -> None:
        """Args: sees_instruction: Makes no difference."""
        self.sees_instruction = sees_instruction

    def passes(self, experts: int) -> int:
        """None."""
        return 0

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order."""
        return [
            answer({expert: _uniform(sighting.episode_id, expert) for expert in candidates.experts})
            for sighting in sightings
        ]


class InstructionMatchRouter:
    """Compares words with the experts' training instructions: |A and B| / |A or B| (P. Jaccard, 1901)."""

    name = "instruction-match"

    def __init__(self, *, sees_instruction: bool = True) -> None:
        """Args: sees_instruction: False leaves nothing to compare."""
        self.sees_instruction = sees_instruction

    def passes(self, experts: int) -> int:
        """None."""
        return 0

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order; `unknown` is what its closest instruction's score lacks of 1."""
        known = {expert: _words(candidates.instructions[expert]) for expert in candidates.experts}
        answers = []
        for sighting in sightings:
            words = _words(sighting.instruction) if self.sees_instruction else frozenset()
            scores = {expert: _jaccard(words, theirs) for expert, theirs in known.items()}
            answers.append(answer(scores, 1.0 - max(scores.values())))
        return answers


class OracleRouter:
    """Is told the task: what is lost with it is lost by merging, not by routing."""

    name = "oracle"

    def __init__(self, *, sees_instruction: bool = True) -> None:
        """Args: sees_instruction: Makes no difference."""
        self.sees_instruction = sees_instruction

    def passes(self, experts: int) -> int:
        """None."""
        return 0

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order.

        Raises:
            RoutingError: There is no expert of a sighting's task.
        """
        for sighting in sightings:
            if sighting.task not in candidates.experts:
                meant = nearest(sighting.task, candidates.experts)
                raise RoutingError(f"router 'oracle': expected a task that has an expert, got '{sighting.task}'{meant}")
        return [
            answer({expert: float(expert == sighting.task) for expert in candidates.experts}) for sighting in sightings
        ]


def _uniform(episode_id: str, expert: str) -> float:
    """A number in [0, 1) that is the same on every machine."""
    return int(content_hash({"episode": episode_id, "expert": expert}), 16) / 16**16


def _words(instruction: str) -> frozenset[str]:
    return frozenset(re.findall(r"[a-z0-9]+", instruction.lower()))


def _jaccard(a: frozenset[str], b: frozenset[str]) -> float:
    return len(a & b) / len(a | b) if a | b else 0.0
