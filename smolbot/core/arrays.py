"""Array types, and the shape checks that all public functions share."""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
import numpy.typing as npt

from smolbot.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


def as_count(value: Any, least: int, name: str) -> int:
    """Return `value` as a whole number that is not too small: a seed, a number of processes or of trials.

    Parameters
    ----------
    value : int
        Of Python or numpy.
    least : int
        Smallest number allowed.
    name : str
        Name of the value, for messages.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If it is no whole number, or smaller.

    Examples
    --------
    >>> as_count(-1, 0, "seed")
    Traceback (most recent call last):
    ...
    smolbot.errors.InputError: seed must be a whole number of at least 0; got -1.
    """
    try:
        count = operator.index(value)
    except TypeError:
        count = least - 1
    if count < least:
        raise InputError(f"{name} must be a whole number of at least {least}; got {value!r}.")
    return count


MAX_SIZE_FOR_DOT = 64
"""Elements up to which a dot product is the fastest check that an array is finite."""


def _is_surely_finite(value: FloatArray) -> bool:
    """Return True only if all values are finite; False may also mean that very large values overflowed."""
    if value.size <= MAX_SIZE_FOR_DOT:
        flat = value.reshape(-1)
        return math.isfinite(flat.dot(flat))
    return math.isfinite(value.sum())


def as_floats(value: Any, shape: tuple[int | None, ...], name: str, *, finite: bool = True) -> FloatArray:
    """Return `value` as a C-ordered float array of the requested shape.

    Parameters
    ----------
    value : array_like
    shape : tuple of int or None
        Requested shape; ``None`` matches any length.
    name : str
        Name of the value, for messages.
    finite : bool
        Whether nan and infinity are refused.

    Returns
    -------
    ndarray
        `value` itself where it already has the right type and shape.

    Raises
    ------
    InputError
        If the value is not numeric, has another shape, or holds nan or infinity where `finite` is set.
    """
    plain = type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous
    if plain and value.shape == shape and (not finite or _is_surely_finite(value)):
        return value
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers of shape {_format_shape(shape)}; got {value!r}.") from error
    if array.ndim != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        hint = ""
        if len(shape) == 2 and array.shape == (shape[1],):
            hint = f" For one row, pass {name}[None, :]."
        raise InputError(f"{name} must have shape {_format_shape(shape)}; got {array.shape}.{hint}")
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name} must be finite; entry {where} is {array[where]}.")
    return array


def freeze(array: FloatArray) -> FloatArray:
    """Return a read-only copy, for fields of frozen dataclasses.

    Parameters
    ----------
    array : ndarray

    Returns
    -------
    ndarray
        Same shape; not writeable.
    """
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _format_shape(shape: tuple[int | None, ...]) -> str:
    names = iter("nmkl")
    parts = [next(names) if size is None else str(size) for size in shape]
    return f"({parts[0]},)" if len(parts) == 1 else f"({', '.join(parts)})"
