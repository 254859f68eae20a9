"""A base class for wrappers of simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robogauntlet.adapters.contract import (
    Delivered,
    FloatArray,
    Image,
    Measured,
    Motion,
    Observation,
    Simulation,
    StepOutcome,
)
from robogauntlet.adapters.motion import motion_reader
from robogauntlet.adapters.scene_control import SceneControls, scene_controls_of


class SimulationWrapper:
    """Forwards all calls to a simulation; subclasses change some of them."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.action_spec, self.observation_spec = simulation.action_spec, simulation.observation_spec

    @property
    def scene_controls(self) -> SceneControls:
        """The controls of the wrapped simulation."""
        return scene_controls_of(self.simulation)

    def reset(self, seed: int) -> None:
        """Forward to the simulation."""
        self.simulation.reset(seed)

    def observe(self) -> Observation:
        """Forward to the simulation."""
        return self.simulation.observe()

    def step(self, action: FloatArray) -> StepOutcome:
        """Forward to the simulation."""
        return self.simulation.step(action)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Forward to the simulation."""
        return self.simulation.privileged_state()

    def motion(self, entries: Sequence[str]) -> Motion:
        """Forward to the simulation."""
        return motion_reader(self.simulation)(entries)

    def state_hash(self) -> str:
        """Forward to the simulation."""
        return self.simulation.state_hash()

    def picture(self) -> Image:
        """Forward to the simulation."""
        return self.simulation.picture()

    def delivered(self) -> Delivered:
        """Forward to the simulation, if it measures what it changed."""
        return self.simulation.delivered() if isinstance(self.simulation, Measured) else Delivered(None)

    def render_device(self) -> str:
        """Forward to the simulation."""
        return self.simulation.render_device()

    def close(self) -> None:
        """Forward to the simulation."""
        self.simulation.close()
