# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Decorators that compile functions: kernels that Python calls, and their subroutines."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numba as nb

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


def compiled(function: Any, *types: nb.types.Type) -> Callable[[], Callable[..., Any]]:
    """
    Return a function that compiles or loads a kernel for its only signature.

    Calling the compiled function takes half as long as calling the kernel, which looks up the
    types of all arguments each time.
    """
    return cache(lambda: function.compile(types))
