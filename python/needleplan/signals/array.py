"""The one kind of array that the mechanics use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "ComplexArray"]

Array = NDArray[np.float64]
"""Double-precision numbers; the docstring of whoever takes or gives one says its shape."""

ComplexArray = NDArray[np.complex128]
"""Complex gains, poles and zeros."""
