"""Sizes of effects by what they do: the RMS of their contribution to the training data."""

from __future__ import annotations

from collections.abc import Callable

_TOLERANCE = 0.01
_SEARCHES = 40


def scaled(rms: Callable[[float], float], wanted: float, first: float, largest: float, *, linear: bool) -> float:
    """The size whose contribution has the wanted RMS, within 1 %; the largest where even that does not reach it.

    linear effects need one trial of the size `first`; others are bracketed from it, then bisected with secants between.
    """
    if linear:
        one = rms(first)
        return largest if one * largest <= wanted * first else first * wanted / one
    low, low_rms, high = 0.0, 0.0, first
    high_rms = rms(high)
    while high_rms < wanted:
        if high >= largest:
            return largest
        low, low_rms, high = high, high_rms, min(2.0 * high, largest)
        high_rms = rms(high)
    for search in range(_SEARCHES):
        share = (wanted - low_rms) / (high_rms - low_rms) if search % 3 < 2 else 0.5
        middle = low + min(max(share, 0.02), 0.98) * (high - low)
        value = rms(middle)
        if abs(value - wanted) <= _TOLERANCE * wanted:
            return middle
        if value < wanted:
            low, low_rms = middle, value
        else:
            high, high_rms = middle, value
    return 0.5 * (low + high)
