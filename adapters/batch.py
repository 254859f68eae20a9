"""Several simulations of one task in one process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from adapters.contract import FloatArray, Observation, Simulation, StepOutcome


class SeparateSimulations:
    """A `SimulationBatch` of simulations that know nothing of each other: what one does costs what it costs alone."""

    def __init__(self, members: Sequence[Simulation]) -> None:
        """Args: members: open simulations of one task."""
        self.members = members

    def step(self, actions: Mapping[int, FloatArray]) -> Mapping[int, StepOutcome]:
        """One control step of each of these members."""
        return {member: self.members[member].step(action) for member, action in actions.items()}

    def observe(self, members: Sequence[int]) -> Mapping[int, Observation]:
        """What each of these members looks like now."""
        return {member: self.members[member].observe() for member in members}

    def close(self) -> None:
        """Close all members."""
        for member in self.members:
            member.close()
