"""Noise for builders: whole numbers in, the same numbers out, for ever and everywhere.

NumPy's generators are free to change their streams between versions; a picture must not change with them. The mixing
steps are multiply, add and xor-shift on 32-bit words with odd multipliers, each of them a bijection of the words.
"""

import numpy as np

from pipeline.types import F64, U32


def hash32(seed: int, *lattice: np.ndarray | int) -> U32:
    """A well mixed 32-bit word for each lattice point; arguments are whole numbers (arrays broadcast), negative ones too."""
    word = np.asarray(seed & 0xFFFFFFFF, np.uint64)
    for coordinate in lattice:
        word = _mix(word * np.uint64(0x9E3779B1) + np.asarray(coordinate).astype(np.int64).view(np.uint64))
    return _mix(word + np.uint64(0x6A09E667)).astype(np.uint32)


def uniform(seed: int, *lattice: np.ndarray | int) -> F64:
    """Evenly spread multiples of 2^-16 in [0, 1), one for each lattice point."""
    return (hash32(seed, *lattice) >> np.uint32(16)).astype(np.float64) * 2.0**-16


def _mix(word: np.ndarray) -> np.ndarray:
    """Bijective mix of 32-bit words, held in uint64 so that products do not overflow."""
    mask = np.uint64(0xFFFFFFFF)
    word = word & mask
    for shift, odd in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 0xC2B2AE3D)):
        word = ((word ^ (word >> np.uint64(shift))) * np.uint64(odd)) & mask
    return word ^ (word >> np.uint64(16))
