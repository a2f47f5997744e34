"""Python's garbage collection, kept from making a loop wait."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["no_long_collections"]


@contextmanager
def no_long_collections() -> Iterator[None]:
    """Keep what is there now from being looked at by every full collection of garbage, in all of the process.

    That takes 40 ms and more with the libraries of an insertion, while a robot waits 30 ms for a sign of life.
    What comes meanwhile is collected as ever.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
