"""What every perturbation does alike: the clean world, and what was measured held against what was asked for."""

from __future__ import annotations

from collections.abc import Mapping

from adapters.adjusting import Adjustable, Adjusters
from adapters.contract import Delivered, FloatArray, Image, NotDelivered, Observation, Simulation, StepOutcome
from suites.axes import Axis
from suites.vocabulary import Condition, Episode


class Perturbed:
    """A simulation in the clean world, with something between it and the policy."""

    def __init__(self, simulation: Simulation, axis: Axis, episode: Episode) -> None:
        self.simulation, self.axis, self.episode = simulation, axis, episode
        self.level = axis.value(episode.condition.severity)
        self.also = axis.also[episode.condition.severity - 1] if axis.also else 0.0
        self.action_spec, self.observation_spec = simulation.action_spec, simulation.observation_spec

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the clean episode of the seed: no such axis touches the world itself."""
        self.simulation.reset(seed, Condition())

    @property
    def adjusters(self) -> Adjusters:
        """What of the simulation's world can be adjusted."""
        return self.simulation.adjusters if isinstance(self.simulation, Adjustable) else Adjusters()

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

    def delivered(self) -> Delivered | None:
        """What was measured, see the axis."""
        raise NotImplementedError

    def picture(self) -> Image:
        """As the simulation."""
        return self.simulation.picture()

    def render_device(self) -> str:
        """As the simulation."""
        return self.simulation.render_device()

    def close(self) -> None:
        """As the simulation."""
        self.simulation.close()

    def checked(self, value: float) -> float:
        """Refuse what is farther from the level than the axis allows.

        Raises:
            NotDelivered: It is.
        """
        if not abs(value - self.level) <= self.axis.tolerance:
            raise NotDelivered(
                f"{self.episode.condition}: expected {self.level:g} {self.axis.unit}, delivered {value:.2f}"
            )
        return value
