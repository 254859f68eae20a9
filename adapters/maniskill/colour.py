"""sRGB and the pixels of SAPIEN, which encode linear light with a plain power."""

from __future__ import annotations

import numpy as np

from adapters.contract import FloatArray

POWER = 2.2
"""A pixel is SAPIEN's light to the power of one over this."""
TYPICAL = 0.6
"""A pixel of the usual brightness of these scenes, of 1."""


def decoded(pixel: FloatArray) -> FloatArray:
    """Linear light of sRGB from 0 to 1."""
    pixel = np.asarray(pixel, np.float64)
    return np.where(pixel <= 0.04045, pixel / 12.92, ((np.maximum(pixel, 0.0) + 0.055) / 1.055) ** 2.4)


def encoded(light: FloatArray) -> FloatArray:
    """Linear light as sRGB: undoes `decoded`."""
    light = np.asarray(light, np.float64)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0.0) ** (1 / 2.4) - 0.055)


def lamp_factor(gain: FloatArray) -> FloatArray:
    """What SAPIEN's lamps are scaled by so that the linear light of a typical pixel is scaled by `gain`.

    The two encodings part in the dark: three stops at the lamps would be 2.85 in the picture.
    """
    return (encoded(decoded(np.array(TYPICAL)) * gain) / TYPICAL) ** POWER


def gain_of(factor: FloatArray) -> FloatArray:
    """The gain that lamps scaled by `factor` amount to: undoes `lamp_factor`."""
    return decoded(TYPICAL * factor ** (1 / POWER)) / decoded(np.array(TYPICAL))
