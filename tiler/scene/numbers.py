"""Many decimal numbers of a text file at once."""

import warnings
from collections.abc import Iterable

import numpy as np


def numbers_in(words: Iterable[bytes], count: int, dtype: type[np.generic]) -> np.ndarray | None:
    """The `count` numbers in words that blanks separate; None where there are fewer, more, or something else.

    A number of ours stands at the end: it is read only if nothing before it stopped the parser.
    """
    text = b" ".join([*words, b"7"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the parser stopped early: the count tells
        try:
            values = np.fromstring(text, dtype, sep=" ")
        except ValueError:
            return None
    if len(values) != count + 1 or values[-1] != 7:
        return None
    return values[:-1]
