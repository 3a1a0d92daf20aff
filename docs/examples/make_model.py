"""Writes a small model to try things with: `ring.obj`, a control mesh of quads, and `ring.png`, its displacement map."""

import math

import numpy as np
from PIL import Image

ALONG, AROUND = 12, 8  # faces around the ring, and around its tube

with open("ring.obj", "w") as file:
    for i in range(ALONG):
        for j in range(AROUND):
            a, b = 2 * math.pi * i / ALONG, 2 * math.pi * j / AROUND
            radius = 1.0 + 0.4 * math.cos(b)
            file.write(f"v {radius * math.cos(a):.6f} {0.4 * math.sin(b):.6f} {-radius * math.sin(a):.6f}\n")
    for i in range(
        ALONG + 1
    ):  # texture coordinates go from 0 to 1 both ways, so the last column repeats the first place
        for j in range(AROUND + 1):
            file.write(f"vt {i / ALONG:.6f} {j / AROUND:.6f}\n")
    for i in range(ALONG):
        for j in range(AROUND):
            corners = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))  # counter-clockwise seen from outside
            names = [
                f"{x % ALONG * AROUND + y % AROUND + 1}/{x * (AROUND + 1) + y + 1}"
                for x, y in corners
            ]  # fmt: skip
            file.write(f"f {' '.join(names)}\n")

t, s = np.mgrid[0:128, 0:256] * 2 * np.pi
bumps = np.sin(12 * s / 256) * np.sin(8 * t / 128)  # as often as there are faces: the map repeats without a step
Image.fromarray(np.round(127.5 + 127.5 * bumps).astype(np.uint8)).save("ring.png")
