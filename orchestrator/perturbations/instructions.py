"""Perturbed instructions: paraphrases, none, another goal."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.adapters.contract import Delivered, Measured, Observation, UnsupportedCondition
from robogauntlet.orchestrator.perturbations.base import Perturbed
from robogauntlet.suites.axes import NO_VARIANT_NAME
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES, why_unsupported


class Instruction(Perturbed):
    """A paraphrase of the instruction."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._given: set[tuple[str, str]] = set()
        """The task's own instructions, each with the one that the policy got."""

    def observe(self) -> Observation:
        """The observation with another instruction.

        Raises:
            UnsupportedCondition: There is no other for the task's instruction.
        """
        observation = self.simulation.observe()
        if reason := why_unsupported(self.axis.name, observation.instruction):
            raise UnsupportedCondition(f"{self.episode.condition}: {reason}")
        instruction = self._changed(observation.instruction)
        self._given.add((observation.instruction, instruction))
        return replace(observation, instruction=instruction)

    def delivered(self) -> Delivered:
        """What was changed: words of the task's own that are left out, and added ones. Rewording has no value."""
        if any(own == given for own, given in self._given):
            raise self._not_delivered("expected other words than the task's own, got the same")
        if not self._given:
            return Delivered(None)
        own, given = (Counter(re.findall(r"\w+", text)) for text in min(self._given))
        return Delivered(None, {"words_left_out": (own - given).total(), "words_added": (given - own).total()})

    def _changed(self, instruction: str) -> str:
        return PARAPHRASES[instruction][int(self.severity) - 1]


class BlankInstruction(Instruction):
    """An empty instruction."""

    def _changed(self, instruction: str) -> str:
        return ""


class WrongGoal(Instruction):
    """The instruction of another goal in the same scene."""

    def _changed(self, instruction: str) -> str:
        return OTHER_GOALS[instruction]


class VariantName(Instruction):
    """The instruction that the benchmark's own code gives, with the name of the variant."""

    def _changed(self, instruction: str) -> str:
        published = task_descriptions()[self.episode.task].published_instruction
        if not published:
            raise UnsupportedCondition(f"{self.episode.condition}: {NO_VARIANT_NAME}")
        return published

    def delivered(self) -> Delivered:
        """What the instruction and the variant itself changed: `variant` and further numbers."""
        given = super().delivered()
        if not isinstance(self.simulation, Measured):
            return given
        own = self.simulation.delivered()
        value = {} if own.value is None else {"variant": own.value}
        return Delivered(given.value, {**value, **own.statistics})
