"""The light of the PyBullet adapter: TinyRenderer's one lamp and its ambient light, which every image is given anew.

TinyRenderer writes lamp times albedo straight into the pixel, which is sRGB, so lamps are scaled as pixels are to be.
The ambient light has no colour of its own: a coloured light is drawn once for each channel. What is not drawn upon, the
white background, is lit by nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adapters.adjusting import Light, unit
from suites.photometry import gain_of, pixel_factor


@dataclass(frozen=True)
class Lamps:
    """What TinyRenderer takes; the defaults are PyBullet's own."""

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
    """See `adapters.adjusting.Lights`. PyBullet tells nothing of its lamps, so what is read is what is drawn with."""

    def __init__(self) -> None:
        self.lamps: Sequence[tuple[slice, Lamps]] = ()
        """What to draw with: channels, and the lamps of an image from which to take them."""
        self.undo()

    def undo(self) -> None:
        """Light the scene as PyBullet does."""
        self.lamps = [(ALL_CHANNELS, OWN)]

    def light(self) -> Light:
        """The light that images are drawn with."""
        gain = np.empty(3)
        for channels, lamps in self.lamps:
            gain[channels] = gain_of(np.array(lamps.ambient / OWN.ambient), USUAL)
        return Light(gain, unit(np.array(self.lamps[0][1].direction)))

    def set_light(self, light: Light) -> None:
        """Draw with another light, until the next reset."""
        red, green, blue = (_dimmed(light, factor) for factor in pixel_factor(light.gain, USUAL).tolist())
        if red == green == blue:
            self.lamps = [(ALL_CHANNELS, red)]
        else:
            self.lamps = [(slice(i, i + 1), lamps) for i, lamps in enumerate((red, green, blue))]


def _dimmed(light: Light, factor: float) -> Lamps:
    x, y, z = light.direction.tolist()
    return replace(
        OWN,
        direction=(x, y, z),
        ambient=factor * OWN.ambient,
        diffuse=factor * OWN.diffuse,
        specular=factor * OWN.specular,
    )
