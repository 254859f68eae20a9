"""A simulation with something around it."""

from __future__ import annotations

from collections.abc import Mapping

from adapters.adjusting import Adjustable, Adjusters
from adapters.contract import FloatArray, Image, Observation, Simulation, StepOutcome
from suites.vocabulary import Condition


class Around:
    """Does what the simulation in it does; a subclass says what is different."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.action_spec, self.observation_spec = simulation.action_spec, simulation.observation_spec

    @property
    def adjusters(self) -> Adjusters:
        """What of the simulation's world can be adjusted."""
        return self.simulation.adjusters if isinstance(self.simulation, Adjustable) else Adjusters()

    def reset(self, seed: int, condition: Condition) -> None:
        """As the simulation."""
        self.simulation.reset(seed, condition)

    def observe(self) -> Observation:
        """As the simulation."""
        return self.simulation.observe()

    def step(self, action: FloatArray) -> StepOutcome:
        """As the simulation."""
        return self.simulation.step(action)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """As the simulation."""
        return self.simulation.privileged_state()

    def state_hash(self) -> str:
        """As the simulation."""
        return self.simulation.state_hash()

    def picture(self) -> Image:
        """As the simulation."""
        return self.simulation.picture()

    def render_device(self) -> str:
        """As the simulation."""
        return self.simulation.render_device()

    def close(self) -> None:
        """As the simulation."""
        self.simulation.close()
