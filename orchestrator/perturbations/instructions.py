"""The goal in other words."""

from __future__ import annotations

from dataclasses import replace

from robogauntlet.adapters.contract import Delivered, NotDelivered, Observation, UnsupportedCondition
from robogauntlet.orchestrator.perturbations.base import Perturbed
from robogauntlet.suites.axes import why_unsupported
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES


class Instruction(Perturbed):
    """The goal in other words."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
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


class BlankInstruction(Instruction):
    """No instruction."""

    def words(self, instruction: str) -> str:
        """Nothing."""
        return ""


class WrongGoal(Instruction):
    """Another goal in the same scene."""

    def words(self, instruction: str) -> str:
        """The other goal."""
        return OTHER_GOALS[instruction]
