"""What the commands print: the answer on standard output, everything else on standard error."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["ProgressLine", "complain", "note", "percent", "print_json", "print_lines"]


def note(text: str) -> None:
    """Say on standard error what is going on."""
    print(text, file=sys.stderr)


def complain(text: str) -> int:
    """Say on standard error why the answer is no, and return the exit code for that."""
    print(f"needleplan: {text}", file=sys.stderr)
    return 1


def print_json(record: Mapping[str, object] | Sequence[object]) -> None:
    """Print a record or a list as JSON, one entry a line; numbers that JSON does not have become null."""
    plain = _plain(record)
    if isinstance(plain, dict):
        entries, brackets = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in plain.items()], "{}"
    else:
        entries, brackets = [json.dumps(entry) for entry in plain], "[]"
    print(brackets[0], ",\n".join(f"  {entry}" for entry in entries), brackets[1], sep="\n")


def print_lines(title: str, lines: Mapping[str, str]) -> None:
    """Print a title and named lines."""
    print(title)
    for name, text in lines.items():
        print(f"  {name:<12} {text}")


def percent(probability: float) -> str:
    """Return a probability as a percentage."""
    return f"{100 * probability:.1f} %"


class ProgressLine:
    """Shows the progress of a solve on standard error: one line that is rewritten, or now and then a new one."""

    def __init__(self) -> None:
        self._on_screen = sys.stderr.isatty()
        self._pause_s = 0.1 if self._on_screen else 1.0
        self._due_s = time.monotonic() + self._pause_s
        self._shown = False

    def __call__(self, sweeps: float, residual: float, threshold: float) -> None:
        """Show the progress, if the last time is long enough ago."""
        if time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + self._pause_s
        line = f"solving: {sweeps:.1f} sweeps, residual {residual:.3g}, ends below {threshold:.3g}"
        print(f"\r\x1b[K{line}" if self._on_screen else line, end="" if self._on_screen else "\n", file=sys.stderr)
        sys.stderr.flush()
        self._shown = True

    def close(self) -> None:
        """End the line."""
        if self._on_screen and self._shown:
            print(file=sys.stderr)


def _plain(value: object) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
