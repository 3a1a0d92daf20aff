"""The colours of the heat maps, made by formula: even steps of lightness, from dark violet over green to pale yellow.

In OKLab (Ottosson 2020, https://bottosson.github.io/posts/oklab/) lightness rises by the same amount from each colour to the
next, so equal differences look equal and the order can be read without any hue: in grey, in print, and by readers who do not
tell red from green. Hue runs from violet to yellow, the pair that they do tell apart.
"""

import numpy as np

from pipeline.types import F64, U8

LIGHTNESS = (0.24, 0.93)
HUE = (305.0, 105.0)  # degrees
CHROMA = (0.115, 0.165)  # at the dark end and at the light end; straight between
STEPS = 256

# OKLab to cone responses (before they are cubed), and cone responses to linear sRGB.
_LMS = np.array(
    [(1.0, 0.3963377774, 0.2158037573), (1.0, -0.1055613458, -0.0638541728), (1.0, -0.0894841775, -1.2914855480)]
)
_RGB = np.array(
    [
        (4.0767416621, -3.3077115913, 0.2309699292),
        (-1.2684380046, 2.6097574011, -0.3413193965),
        (-0.0041960863, -0.7034186147, 1.7076147010),
    ]
)


def linear_from_oklab(lab: F64) -> F64:
    """Linear sRGB of OKLab colours, float64[n, 3]; outside of 0..1 where a screen cannot show it."""
    return ((lab @ _LMS.T) ** 3) @ _RGB.T


def ramp(steps: int = STEPS) -> U8:
    """The colours, uint8[steps, 3] sRGB. Chroma gives way where the screen cannot show it; lightness never does."""
    t = np.linspace(0.0, 1.0, steps)
    lightness = LIGHTNESS[0] + t * (LIGHTNESS[1] - LIGHTNESS[0])
    hue = np.radians(HUE[0] + t * (HUE[1] - HUE[0]))
    wanted = CHROMA[0] + t * (CHROMA[1] - CHROMA[0])

    def linear(part: F64) -> F64:
        chroma = wanted * part
        return linear_from_oklab(np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1))

    low, high = np.zeros(steps), np.ones(steps)
    for _ in range(20):  # bisection on the largest part of the chroma that fits
        middle = 0.5 * (low + high)
        fits = ((linear(middle) >= 0.0) & (linear(middle) <= 1.0)).all(axis=1)
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    rgb = np.clip(linear(low), 0.0, 1.0)
    srgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return np.round(srgb * 255.0).astype(np.uint8)


def ramp_text() -> str:
    """The colours as hexadecimal digits, six for each."""
    return ramp().tobytes().hex()
