# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
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

_INLINED: dict[str, Any] = {**_SUBROUTINE, 'forceinline': True}
inlined = nb.njit(**_INLINED)
"""Compile a subroutine that every step calls."""

_REDUCTION: dict[str, Any] = {**_INLINED, 'fastmath': {'reassoc'}}
reduction = nb.njit(**_REDUCTION)
"""Compile a subroutine whose sums may be reordered, which is faster."""


def compiled(function: Any, *types: nb.types.Type) -> Callable[[], Callable[..., Any]]:
    """
    Return a function that compiles or loads a kernel for its only signature.

    Calling the compiled function takes half as long as calling the kernel, which looks up the
    types of all arguments each time.
    """
    return cache(lambda: function.compile(types))
