"""One thread for BLAS while ngepc computes.

The matrices that ngepc hands to numpy have at most a few hundred rows.  Threads of OpenBLAS or MKL
do not help with them, and while they wait for each other they take the processor from everything
else: a solve costs up to ten times as much (docs/cost.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

LOADED = np, scipy.linalg
"""Each has a BLAS library of its own, which is found below because it is loaded by now."""

_LIMIT = ThreadpoolController().wrap(limits=1, user_api="blas")

Function = TypeVar("Function", bound=Callable)


def one_blas_thread(function: Function) -> Function:
    """Decorate a function: BLAS has one thread in it, and afterwards as many as before.

    Decorated functions may call each other, in several threads of Python as well.
    """
    return cast(Function, _LIMIT(function))
