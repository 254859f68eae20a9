"""The light of the PyBullet adapter: TinyRenderer's one lamp and its ambient light, arguments of every image.

TinyRenderer writes lamp times albedo into the pixel, which is sRGB, so lamps are scaled like pixels. The ambient light
has no colour, so a coloured light is rendered once for each channel. The white background is not lit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robogauntlet.adapters.photometry import gain_of, pixel_factor
from robogauntlet.adapters.scene_control import Light, unit


@dataclass(frozen=True)
class Lamps:
    """Arguments of TinyRenderer; the defaults are PyBullet's own."""

    direction: tuple[float, float, float] = (-50.0, 30.0, 100.0)
    """From the scene to the light."""
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    distance: float = 2.0
    ambient: float = 0.6
    diffuse: float = 0.35
    specular: float = 0.05


OWN = Lamps()
USUAL = 225.0
"""A pixel of the usual brightness of these scenes, whose table is nearly white."""
ALL_CHANNELS = slice(0, 3)


class PyBulletLights:
    """`Lights` of `scene_control`. PyBullet cannot read its lamps back, so the arguments of images are returned."""

    def __init__(self) -> None:
        self.lamps: Sequence[tuple[slice, Lamps]] = ()
        """Channels, and the lamps of the image from which they are taken."""
        self.undo()

    def undo(self) -> None:
        """Restore the light."""
        self.lamps = [(ALL_CHANNELS, OWN)]

    def light(self) -> Light:
        """Return the present light of images."""
        gain = np.empty(3)
        for channels, lamps in self.lamps:
            gain[channels] = gain_of(np.array(lamps.ambient / OWN.ambient), USUAL)
        return Light(gain, unit(np.array(self.lamps[0][1].direction)))

    def set_light(self, light: Light) -> None:
        """Set the light, until the next reset."""
        red, green, blue = (_dimmed(light, factor) for factor in pixel_factor(light.gain, USUAL).tolist())
        if red == green == blue:
            self.lamps = [(ALL_CHANNELS, red)]
        else:
            self.lamps = [(slice(i, i + 1), lamps) for i, lamps in enumerate((red, green, blue))]


def _dimmed(light: Light, factor: float) -> Lamps:
    x, y, z = light.direction.tolist()
    return Lamps((x, y, z), OWN.colour, OWN.distance, factor * OWN.ambient, factor * OWN.diffuse, factor * OWN.specular)
