# SPDX-License-Identifier: Apache-2.0
"""Refuse bad numbers at the door, quoting them."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def finite(name: str, value: Any) -> float:
    """Return `value` as a float, or raise ValueError if it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ValueError(f'{name} must be a number, got {value!r}')
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f'{name} must be finite, got {number}')
    return number


def positive(name: str, value: Any) -> float:
    """Return `value` as a float, or raise ValueError if it is not finite and above 0."""
    number = finite(name, value)
    if number <= 0.0:
        raise ValueError(f'{name} must be finite and positive, got {number}')
    return number


def not_negative(name: str, value: Any) -> float:
    """Return `value` as a float, or raise ValueError if it is not finite and at least 0."""
    number = finite(name, value)
    if number < 0.0:
        raise ValueError(f'{name} must be finite and not negative, got {number}')
    return number


def below_one(name: str, value: Any) -> float:
    """Return `value` as a float, or raise ValueError if it is not in [0, 1)."""
    number = finite(name, value)
    if not 0.0 <= number < 1.0:
        raise ValueError(f'{name} must be at least 0 and below 1, got {number}')
    return number


def positive_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise ValueError quoting the first bad one."""
    return _all_within(name, values, low=0.0, open_low=True, high=math.inf)


def below_one_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise ValueError quoting the first not in [0, 1)."""
    return _all_within(name, values, low=0.0, open_low=False, high=1.0)


def not_negative_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise ValueError quoting the first below 0."""
    return _all_within(name, values, low=0.0, open_low=False, high=math.inf)


def _all_within(
    name: str, values: ArrayLike, *, low: float, open_low: bool, high: float
) -> NDArray[np.float64]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be numbers, got {values!r}') from error
    good = (array > low) if open_low else (array >= low)
    good &= array < high  # NaN fails the first comparison, infinity the second
    if not good.all():
        first = array[~good].flat[0]
        bound = f'{"above" if open_low else "at least"} {low:g}'
        ceiling = 'finite' if math.isinf(high) else f'below {high:g}'
        raise ValueError(f'{name} must be {bound} and {ceiling}, got {first}')
    return array
