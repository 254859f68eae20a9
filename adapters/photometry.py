"""Photometry and colorimetry: linear light, stops, kelvin, distances in CIELAB. Pure functions.

Images are sRGB (IEC 61966-2-1). Colour science is the package of that name (https://www.colour-science.org).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Share of red, green and blue in the luminance of sRGB."""
DARKEST, BRIGHTEST = 40, 247
"""Pixel values between which a change of light can be measured, without quantisation and saturation."""
FAINTEST = 4
"""Smallest value of such a pixel in dimmed light."""
DAYLIGHT = 6500.0
"""Colour temperature (K) of sRGB's white."""
COOLEST, WARMEST = 25_000.0, 1_700.0
"""Limits of the search for a colour temperature (K)."""
BISECTIONS = 40


def linear(image: NDArray[np.integer] | Floats) -> Floats:
    """Convert sRGB values (0 to 255) to linear light (0 to 1)."""
    return np.asarray(_colour().models.eotf_sRGB(np.asarray(image, dtype=np.float64) / 255), dtype=np.float64)


def encoded(light: Floats) -> Floats:
    """Convert linear light (0 to 1) to sRGB values (0 to 255), not rounded."""
    return np.asarray(255 * _colour().models.eotf_inverse_sRGB(np.asarray(light, dtype=np.float64)), dtype=np.float64)


def pixel_factor(gain: Floats, usual: float) -> Floats:
    """Return the factor (3,) of pixel values that scales the linear light of a usual pixel by a gain (3,).

    For renderers that multiply a lamp's strength, or a power of it, with the colour of a surface. Such powers differ
    from sRGB in the dark, so the factor is exact for pixels of the usual value and approximate for others.
    """
    return encoded(linear(np.array(usual)) * gain) / usual


def gain_of(factor: Floats, usual: float) -> Floats:
    """Return the gain of a factor of pixel values, the inverse of `pixel_factor`."""
    return linear(usual * np.asarray(factor)) / linear(np.array(usual))


def channel_gains(pairs: Iterable[tuple[Image, Image]]) -> tuple[Floats, float]:
    """Measure the factors of the linear light of red, green and blue: medians over all usable pixels.

    Each pair shows the same view before and after. A pixel is usable for a channel if its value is in range before and
    after, and if any channel has changed, which excludes an unlit background.

    Returns:
        Factors (3,), NaN for a channel without usable pixels, and the share of the pixels that changed.
    """
    before, after = (np.concatenate([image.reshape(-1, 3) for image in side]) for side in zip(*pairs, strict=True))
    changed = (before != after).any(axis=1)
    usable = changed[:, None] & (before >= DARKEST) & (before <= BRIGHTEST) & (after >= FAINTEST) & (after <= BRIGHTEST)
    gains = np.full(3, math.nan)
    for channel, rows in enumerate(usable.T):
        if rows.any():
            gains[channel] = np.median(linear(after[rows, channel]) / linear(before[rows, channel]))
    return gains, float(changed.mean())


def stops(gains: Floats) -> float:
    """Return gains as exposure values: the logarithm to base 2, averaged over the channels that are not NaN."""
    return float(np.nanmean(np.log2(gains)))


def temperature_gains(kelvin: float) -> Floats:
    """Return the factors (3,) for red, green and blue from 6500 K daylight to a black body, at equal luminance.

    Colours of black bodies: Kang et al., J. Korean Phys. Soc. 41 (2002) 865, from 1667 to 25000 K.
    """
    gains = _black_body(kelvin) / _black_body(DAYLIGHT)
    return np.asarray(gains / (gains @ LUMINANCE))


def temperature_of(gains: Floats) -> float:
    """Return the colour temperature (K) whose `temperature_gains` have this ratio of blue to red; NaN if unknown."""
    ratio = gains[2] / gains[0]
    if not math.isfinite(ratio):
        return math.nan
    low, high = WARMEST, COOLEST  # the ratio grows with the temperature
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        red, _, blue = temperature_gains(middle)
        low, high = (middle, high) if blue / red < ratio else (low, middle)
    return (low + high) / 2


def lab(light: Floats) -> Floats:
    """Convert linear sRGB light (..., 3) to CIELAB (D65)."""
    colour = _colour()
    return np.asarray(colour.XYZ_to_Lab(colour.RGB_to_XYZ(light, "sRGB", apply_cctf_decoding=False), _white()))


def light_of_lab(values: Floats) -> Floats:
    """Convert CIELAB values to linear sRGB light (..., 3), outside 0 to 1 for colours outside the gamut."""
    colour = _colour()
    return np.asarray(colour.XYZ_to_RGB(colour.Lab_to_XYZ(values, _white()), "sRGB", apply_cctf_encoding=False))


def difference(one: Floats, other: Floats) -> float:
    """Return the CIELAB distance (Delta E*ab, 1976) of two colours in linear sRGB light (3,)."""
    return float(np.linalg.norm(lab(one) - lab(other)))


def _black_body(kelvin: float) -> Floats:
    colour = _colour()
    tristimulus = colour.xy_to_XYZ(colour.temperature.CCT_to_xy(kelvin, method="Kang 2002"))
    return np.asarray(colour.XYZ_to_RGB(tristimulus, "sRGB", apply_cctf_encoding=False))


def _white() -> Floats:
    return np.asarray(_colour().RGB_COLOURSPACES["sRGB"].whitepoint)


@cache
def _colour() -> Any:
    with np.printoptions():  # Its import has numpy write floats with 12 digits, in files of tables, too.
        import colour

    return colour
