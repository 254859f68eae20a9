"""The common part of simulations that render single cameras on demand."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from robogauntlet.adapters.contract import PICTURE_SIZE, ActionSpec, FloatArray, Image, Observation, ObservationSpec
from robogauntlet.adapters.frames import proprioception
from robogauntlet.suites.episode import View


class BaseSimulation(ABC):
    """The half of a `robogauntlet.adapters.contract.Simulation` that observes.

    Subclasses add `draw` and, of the contract, `reset`, `step`, `privileged_state`, `state_hash`, `render_device` and
    `close`.
    """

    culling: bool
    """Whether `draw` leaves out shapes outside the view, which changes no pixel. Optional: simulations that always draw
    all shapes have no such attribute."""

    def __init__(self, view: View, instruction: str, action_spec: ActionSpec) -> None:
        """Take the cameras and image size for policies, the goal in words, and the bounds of an action."""
        self.view, self.instruction, self.action_spec = view, instruction, action_spec
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)

    @abstractmethod
    def draw(self, camera: str, size: int) -> Image:
        """Render a new upright image of the present state, (size, size, 3)."""

    @abstractmethod
    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the true state, as the contract defines it."""

    def arm_state(self) -> Mapping[str, FloatArray]:
        """Return the entries of the true state that proprioception has; override it where the others cost time."""
        return self.privileged_state()

    def observe(self) -> Observation:
        """Render the cameras of the view and read the arm."""
        images = {camera: self.draw(camera, self.view.image_size) for camera in self.view.cameras}
        of_joints, native = bool(self.action_spec.joints), len(self.action_spec.numbers) or None
        state = self.arm_state()
        numbers = state["state"] if native else proprioception(state, of_joints=of_joints)
        return Observation(images, numbers, self.instruction, of_joints, native)

    def picture(self) -> Image:
        """Render the third-person view, (256, 256, 3)."""
        return self.draw("third_person", PICTURE_SIZE)
