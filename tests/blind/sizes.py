"""Sizes of effects by what they do: the RMS of their contribution to the training data."""

import math
from collections.abc import Callable

_TOLERANCE = 0.01
_SEARCHES = 40
_SMALLEST = 1e-9  # of the largest size: below it, nothing is left to search


def scaled(rms: Callable[[float], float], wanted: float, first: float, largest: float, *, linear: bool) -> float:
    """The size whose contribution has the wanted RMS, within 1 %; the largest where even that does not reach it.

    Linear effects need one run, with the size `first`. Others are searched for with secants in the logarithms, which
    are exact for any power law, within a bracket that is halved where they leave it.
    """
    if linear:
        one = rms(first)
        return largest if one * largest <= wanted * first else first * wanted / one
    low, high = largest * _SMALLEST, math.inf
    size, last = first, None
    for search in range(_SEARCHES):
        value = rms(size)
        if abs(value - wanted) <= _TOLERANCE * wanted:
            return size
        if value < wanted:
            if size >= largest:
                return largest
            low = size
        else:
            high = size
        power = 1.0
        if last is not None and value > 0.0 and last[1] > 0.0 and value != last[1]:
            power = math.log(value / last[1]) / math.log(size / last[0])
        last = (size, value)
        guess = size * (wanted / value) ** (1.0 / power) if value > 0.0 and power > 0.05 else math.nan
        inside = low < guess < min(high, 20.0 * low if math.isinf(high) else high)
        if not inside or search % 4 == 3:
            guess = 4.0 * low if math.isinf(high) else math.sqrt(low * high)
        size = min(guess, largest)
    return size
