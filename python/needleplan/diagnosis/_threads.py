"""One thread for linear algebra: the matrices of a diagnosis are so small that more threads cost more than they bring.

With its default number of threads, OpenBLAS waits for its own threads. A diagnosis then takes twice the processor time
and up to 40 % longer on two idle cores, and ten times as long if another program uses one of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["one_thread"]

_P = ParamSpec("_P")
_T = TypeVar("_T")


def one_thread(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Return the function with BLAS and LAPACK limited to one thread while it runs."""

    @wraps(function)
    def limited(*args: _P.args, **options: _P.kwargs) -> _T:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **options)

    return limited
