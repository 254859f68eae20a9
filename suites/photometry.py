"""Light and colour as physics has them: linear light, stops, kelvin, distances in CIELAB. Pure functions.

Images are sRGB (IEC 61966-2-1). Colour science is the package of that name (https://www.colour-science.org).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Share of red, green and blue in the luminance of sRGB."""
DARKEST, BRIGHTEST = 40, 247
"""Pixel values between which a change of light can be read off: below quantisation spoils it, above saturation."""
FAINTEST = 4
"""The least that is left of such a pixel value in dimmed light."""
DAYLIGHT = 6500.0
"""Colour temperature (K) of a light that leaves sRGB's white as it is."""
COOLEST, WARMEST = 25_000.0, 1_700.0
"""Colour temperatures (K) between which one is looked for."""
BISECTIONS = 40


def linear(image: NDArray[np.integer] | Floats) -> Floats:
    """Linear light, 0 to 1, of sRGB values from 0 to 255."""
    from colour.models import eotf_sRGB

    return np.asarray(eotf_sRGB(np.asarray(image, dtype=np.float64) / 255), dtype=np.float64)


def encoded(light: Floats) -> Floats:
    """The sRGB values, 0 to 255 and not rounded, of linear light from 0 to 1."""
    from colour.models import eotf_inverse_sRGB

    return np.asarray(255 * eotf_inverse_sRGB(np.asarray(light, dtype=np.float64)), dtype=np.float64)


def pixel_factor(gain: Floats, usual: float) -> Floats:
    """Factor (3,) of the pixel values that scales the linear light of a pixel of usual value by a gain (3,).

    For renderers that know factors only: what they write is a lamp's strength, or a power of it, times the surface's.
    Their powers and sRGB part in the dark, so the factor is exact where most pixels are, and near elsewhere.
    """
    return encoded(linear(np.array(usual)) * gain) / usual


def gain_of(factor: Floats, usual: float) -> Floats:
    """The gain that a factor of the pixel values amounts to: undoes `pixel_factor`."""
    return linear(usual * np.asarray(factor)) / linear(np.array(usual))


def channel_gains(pairs: Iterable[tuple[Image, Image]]) -> tuple[Floats, float]:
    """By which factor the linear light of red, green and blue has changed: the medians over all pixels that tell.

    A pixel tells of a channel if its value is in range before and after, and if the pixel has changed at all: a
    background that no lamp lights does not.

    Args:
        pairs: Images of the same view, before and after.

    Returns:
        Factors (3,), NaN for a channel of which no pixel tells, and the share of the pixels that changed.
    """
    before, after = (np.concatenate([image.reshape(-1, 3) for image in side]) for side in zip(*pairs, strict=True))
    changed = (before != after).any(axis=1)
    usable = changed[:, None] & (before >= DARKEST) & (before <= BRIGHTEST) & (after >= FAINTEST) & (after <= BRIGHTEST)
    gains = np.full(3, math.nan)
    for channel in range(3):
        rows = usable[:, channel]
        if rows.any():
            gains[channel] = np.median(linear(after[rows, channel]) / linear(before[rows, channel]))
    return gains, float(changed.mean())


def stops(gains: Floats) -> float:
    """A change of light as exposure values: the logarithm to base 2, the mean of the channels that are known."""
    return float(np.nanmean(np.log2(gains)))


def temperature_gains(kelvin: float) -> Floats:
    """Factors (3,) for red, green and blue that turn daylight of 6500 K into a black body's, at equal luminance.

    Colours of black bodies: Kang et al., J. Korean Phys. Soc. 41 (2002) 865, from 1667 to 25000 K.
    """
    gains = _black_body(kelvin) / _black_body(DAYLIGHT)
    balanced: Floats = gains / (gains @ LUMINANCE)
    return balanced


def temperature_of(gains: Floats) -> float:
    """The colour temperature (K) whose `temperature_gains` have this ratio of blue to red; NaN if it is not known."""
    ratio = gains[2] / gains[0]
    if not math.isfinite(ratio):
        return math.nan
    low, high = WARMEST, COOLEST  # the ratio grows with the temperature
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        tried = temperature_gains(middle)
        low, high = (middle, high) if tried[2] / tried[0] < ratio else (low, middle)
    return (low + high) / 2


def lab(light: Floats) -> Floats:
    """CIELAB (D65) of linear sRGB light (..., 3)."""
    import colour

    return np.asarray(colour.XYZ_to_Lab(colour.RGB_to_XYZ(light, "sRGB", apply_cctf_decoding=False), _white()))


def light_of_lab(values: Floats) -> Floats:
    """The linear sRGB light (..., 3) of CIELAB values; outside 0 to 1 where the display has no such colour."""
    import colour

    return np.asarray(colour.XYZ_to_RGB(colour.Lab_to_XYZ(values, _white()), "sRGB", apply_cctf_encoding=False))


def difference(one: Floats, other: Floats) -> float:
    """Distance in CIELAB (Delta E*ab, 1976) of two colours in linear sRGB light (3,)."""
    return float(np.linalg.norm(lab(one) - lab(other)))


def _black_body(kelvin: float) -> Floats:
    import colour

    chromaticity = colour.temperature.CCT_to_xy(kelvin, method="Kang 2002")
    return np.asarray(colour.XYZ_to_RGB(colour.xy_to_XYZ(chromaticity), "sRGB", apply_cctf_encoding=False))


def _white() -> Floats:
    import colour

    return np.asarray(colour.RGB_COLOURSPACES["sRGB"].whitepoint)
