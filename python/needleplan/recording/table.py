"""What a file holds before it is cut into trials."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from needleplan.signals import Array

__all__ = ["Table"]


@dataclass(frozen=True)
class Table:
    """Rows of a file: columns of numbers and of texts, all of one length, missing numbers as NaN.

    `places[i]` says where row i stands in the file, for messages, such as "line 7".
    """

    numbers: dict[str, Array]
    texts: dict[str, tuple[str, ...]]
    places: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.places)

    def rows(self, index: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Table:
        """Return some of the rows, by their numbers."""
        return replace(
            self,
            numbers={name: values[index] for name, values in self.numbers.items()},
            texts={name: tuple(values[row] for row in index) for name, values in self.texts.items()},
            places=tuple(self.places[row] for row in index),
        )
