"""Combinations: several axes perturbed in one episode, each measured against the scene without it."""

from __future__ import annotations

from collections.abc import Sequence

from robogauntlet.adapters.contract import Delivered, FloatArray, Observation
from robogauntlet.orchestrator.perturbations.base import Perturbed, PerturbedSimulation
from robogauntlet.suites.axis import Changes


class Combination(PerturbedSimulation):
    """A stack of perturbations. Each draws what it draws alone, and is measured against the layers below it."""

    def __init__(self, layers: Sequence[Perturbed]) -> None:
        """Args: `layers` has the innermost first, each wrapping the one before it."""
        super().__init__(layers[-1])
        self.layers = tuple(layers)

    @property
    def commanded(self) -> FloatArray | None:  # type: ignore[override] # read from the layers
        """The action as the outermost layer that changes actions received it."""
        return next((found for layer in reversed(self.layers) if (found := layer.commanded) is not None), None)

    def preview(self) -> Observation:
        """The observation of a copy of the layers."""
        return self.layers[-1].preview()

    def check_start(self) -> None:
        """Check the last layer's physical state; the others are checked before the next layer changes it."""
        self.layers[-1].check_start()

    def check_instruction(self, instruction: str) -> None:
        """Check that only an axis of the instruction changes the instruction. Raises NotDelivered."""
        if all(layer.axis.changes is not Changes.INSTRUCTION for layer in self.layers):
            self.layers[0].check_instruction(instruction)

    def delivered(self) -> Delivered:
        """What was measured of each axis: `AXIS` is its value, `AXIS.NAME` another number of it.

        Raises:
            NotDelivered: The tolerance of one axis is exceeded.
        """
        found: dict[str, float] = {}
        for layer in self.layers:
            own, name = layer.delivered(), layer.axis.name
            if own.value is not None:
                found[name] = own.value
            found |= {f"{name}.{key}": value for key, value in own.statistics.items()}
        return Delivered(None, found)
