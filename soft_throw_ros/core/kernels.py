# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Decorators that compile functions: kernels that Python calls, and their subroutines."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numba as nb
import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
"""An array of numbers."""

Record: TypeAlias = Any
"""A record of numpy, whose fields numba knows and type checkers do not."""

# There is no fused multiply-add: LLVM would fuse different operations in a kernel from numba's
# cache than in the same kernel just compiled, and the last bits of results would differ.
_OPTIONS: dict[str, Any] = {'error_model': 'numpy'}

kernel = nb.njit(cache=True, nogil=True, **_OPTIONS)
"""Compile a function that Python calls, from any thread."""

_SUBROUTINE: dict[str, Any] = {**_OPTIONS, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
subroutine = nb.njit(**_SUBROUTINE)
"""Compile a function that only kernels call, which takes half as long."""

inlined = nb.njit(**_SUBROUTINE, forceinline=True)
"""Compile a subroutine that every step calls."""


def stepper_kernels(
    record: np.dtype[np.void], advance: Any, read_layer: Any, *, arrays: int
) -> Callable[[], tuple[Callable[..., Any], Callable[..., Any]]]:
    """
    Return a function that compiles or loads both kernels of a stepper for their only types.

    `read_layer` takes so many arrays beside the records. Calling a compiled function takes half as
    long as calling the kernel, which looks up the types of all arguments each time.
    """
    records, rows = nb.from_dtype(record)[::1], nb.float64[:, ::1]
    return cache(lambda: (
        advance.compile((records, rows, rows, rows, nb.float64)),
        read_layer.compile((records, *[rows] * arrays)),
    ))
