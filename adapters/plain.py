"""What simulations have in common that play the clean world only, and draw it themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from adapters.contract import (
    PICTURE_SIZE,
    ActionSpec,
    FloatArray,
    Image,
    Observation,
    ObservationSpec,
    UnsupportedCondition,
)
from adapters.frames import proprioception
from suites.vocabulary import Condition, View


class PlainSimulation(ABC):
    """Half of an `adapters.contract.Simulation`.

    To be written are `begin` and `draw`, and of the contract `step`, `privileged_state`, `state_hash`, `render_device`
    and `close`.
    """

    def __init__(self, view: View, instruction: str, action_spec: ActionSpec) -> None:
        """Take what is the same for all episodes.

        Args:
            view: What is rendered for policies.
            instruction: The goal in words.
            action_spec: What a step accepts.
        """
        self.view, self.instruction = view, instruction
        self.action_spec = action_spec
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)

    @abstractmethod
    def begin(self, seed: int) -> None:
        """Start the episode of `seed`. Nothing of an earlier episode is left."""

    @abstractmethod
    def draw(self, camera: str, size: int) -> Image:
        """An upright image of the world as it is now, (size, size, 3), of its own."""

    @abstractmethod
    def privileged_state(self) -> Mapping[str, FloatArray]:
        """See the contract."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`.

        Raises:
            UnsupportedCondition: `condition` is not clean.
        """
        if condition != Condition():
            raise UnsupportedCondition(f"this adapter cannot bring about {condition}; it offers clean")
        self.begin(seed)

    def observe(self) -> Observation:
        """Render the cameras of the view and read the arm."""
        images = {camera: self.draw(camera, self.view.image_size) for camera in self.view.cameras}
        return Observation(images, proprioception(self.privileged_state()), self.instruction)

    def picture(self) -> Image:
        """The third-person view for people, (256, 256, 3)."""
        return self.draw("third_person", PICTURE_SIZE)
