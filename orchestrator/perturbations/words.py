"""The goal in other words."""

from __future__ import annotations

from dataclasses import replace

from adapters.contract import Delivered, NotDelivered, Observation, UnsupportedCondition
from orchestrator.perturbations.base import Perturbed
from suites.axes import why_unsupported
from suites.paraphrases import OTHER_GOALS, PARAPHRASES
from suites.vocabulary import Condition


class Reworded(Perturbed):
    """The goal in other words."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._told: set[tuple[str, str]] = set()

    def words(self, instruction: str) -> str:
        """What is said in place of the task's own instruction."""
        return PARAPHRASES[instruction][self.episode.condition.severity - 1]

    def observe(self) -> Observation:
        """What the cameras see, with other words.

        Raises:
            UnsupportedCondition: There are none for this instruction.
        """
        seen = self.simulation.observe()
        reason = why_unsupported(self.axis, seen.instruction)
        if reason:
            raise UnsupportedCondition(f"{self.episode.condition}: {reason}")
        told = self.words(seen.instruction)
        self._told.add((seen.instruction, told))
        return replace(seen, instruction=told)

    def delivered(self) -> Delivered | None:
        """The kind of rewording, if the words were others than the task's own."""
        if any(own == told for own, told in self._told):
            raise NotDelivered(f"{self.episode.condition}: expected other words than the task's own, got the same")
        return Delivered(self.level if self._told else None)


class Untold(Reworded):
    """No instruction."""

    def words(self, instruction: str) -> str:
        """Nothing."""
        return ""


class Misled(Reworded):
    """Another goal in the same scene."""

    def words(self, instruction: str) -> str:
        """The other goal."""
        return OTHER_GOALS[instruction]
