"""Binary answers of the page: a JSON header, followed by arrays of numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["pack", "plain", "shares"]

# Arrays begin at multiples of this number of bytes, as typed arrays of JavaScript require.
_ALIGNMENT = 8


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return one message: length of the JSON text (uint32, little-endian), JSON text, arrays.

    The JSON object has the keys of `header` and the key `arrays`: for each name the dtype, the shape, and the offset in
    bytes from the end of the padded JSON text. All numbers are little-endian.
    """
    places: dict[str, Any] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()
        padded = data + bytes(-len(data) % _ALIGNMENT)
        places[name] = {"dtype": array.dtype.name, "shape": array.shape, "offset": offset}
        parts.append(padded)
        offset += len(padded)
    text = json.dumps(plain({**header, "arrays": places}), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % _ALIGNMENT)
    return b"".join([len(text).to_bytes(4, "little"), text, *parts])


def shares(probabilities: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return probabilities as whole numbers of 1 / 65535: half the size, with an error below 0.001 %."""
    whole: NDArray[np.uint16] = np.rint(probabilities * np.float32(65535)).astype(np.uint16)
    return whole


def plain(value: Any) -> Any:
    """Return a copy that JSON can hold: infinity becomes the text "inf", NaN None, and tuples become lists."""
    if isinstance(value, float):
        return "inf" if value == math.inf else value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return value
