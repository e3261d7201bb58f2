"""Validation of numeric arguments: errors name the argument, its value and the rule."""
import math
from numbers import Real

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class UserError(ValueError):
    """Input that cannot be used; the message names it, its value and the rule, in one line."""


def finite(name: str, value: npt.ArrayLike) -> Array:
    """
    Return a number or numbers as an array of floats, all of them finite.

    Raises ValueError naming the argument, the first offending value and the rule.
    """
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        array = np.asarray(None)
    if array.dtype.kind not in 'iuf':
        raise ValueError(f'{name} = {value!r}: must be a number or an array of numbers')
    array = array.astype(np.float64, copy=False)
    good = np.isfinite(array)
    if not good.all():
        index = tuple(np.argwhere(~good)[0].tolist())
        where = f'[{", ".join(map(str, index))}]' if index else ''
        raise ValueError(f'{name}{where} = {array[index]}: must be finite')
    return array


def vectors(name: str, value: npt.ArrayLike, size: int) -> Array:
    """Return an array of shape (..., size) of finite floats, or raise ValueError."""
    array = finite(name, value)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f'{name} has shape {array.shape}: must be (..., {size})')
    return array


def finite_number(name: str, value: float) -> float:
    """Return a single number that is finite, or raise ValueError."""
    if (number := real_number(value)) is None or not math.isfinite(number):
        raise ValueError(f'{name} = {value!r}: must be finite')
    return number


def positive(name: str, value: float) -> float:
    """Return a single number that is positive and finite, or raise ValueError."""
    if (number := real_number(value)) is None or not 0.0 < number < math.inf:
        raise ValueError(f'{name} = {value!r}: must be positive and finite')
    return number


def not_negative(name: str, value: float) -> float:
    """Return a single number that is finite and zero or more, or raise ValueError."""
    if (number := real_number(value)) is None or not 0.0 <= number < math.inf:
        raise ValueError(f'{name} = {value!r}: must be finite and zero or more')
    return number


def real_number(value: object) -> float | None:
    """Return a real number as a float; None for another type and for an overflow."""
    try:
        return float(value) if isinstance(value, Real) and not isinstance(value, bool) else None
    except OverflowError:
        return None
