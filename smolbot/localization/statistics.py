"""The paper's statistics of measurements, linear and circular (Eqs. S20 to S30).

Everywhere `measured` d and `truth` f have k values along the first axis and n datasets along the
second; an array of shape (k,) is one dataset. Units are those of the data; circular data are in rad.

Where the printed equations are wrong or ambiguous: S26 divides by kn - 1, although n means are subtracted
from the data (the paper's choice, kept); S27 takes the modulus of a difference that may lie anywhere on the
circle, so the difference is first wrapped to (-pi, pi]; S29 needs the factor 1/(kn), or S28 is the
root of a negative number.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

NO_DIRECTION = 1e-12
"""Length of a mean of unit vectors below which it has no direction."""


def compute_sum_squared_error(measured: npt.ArrayLike, fitted: npt.ArrayLike) -> float:
    """Compute the sum squared error.

        SSE = sum (d - f)²        (Eq. S20)

    Parameters
    ----------
    measured, fitted : array_like, shape (k,) or (k, n)

    Returns
    -------
    float, in the squared unit of the data

    Examples
    --------
    >>> compute_sum_squared_error([1.0, 2.0, 4.0], [1.0, 2.0, 3.0])
    1.0
    """
    d, f = _as_dataset_pair(measured, fitted)
    return float(np.sum((d - f) ** 2))


def compute_total_sum_of_squares(measured: npt.ArrayLike) -> float:
    """Compute the total sum of squares over all values as one dataset.

        TSS = sum (d - mean d)²        (Eqs. S21, S22)

    Parameters
    ----------
    measured : array_like, shape (k,) or (k, n)

    Returns
    -------
    float, in the squared unit of the data
    """
    d = _as_datasets(measured, "measured")
    return float(np.sum((d - d.mean()) ** 2))


def compute_r_squared(measured: npt.ArrayLike, fitted: npt.ArrayLike) -> float:
    """Compute the coefficient of determination.

        R² = 1 - SSE / TSS        (Eq. S23)

    Parameters
    ----------
    measured, fitted : array_like, shape (k,) or (k, n)

    Returns
    -------
    float
        1 for a perfect fit, 0 for one no better than the mean, negative for a worse one.

    Raises
    ------
    InputError
        If all measured values are the same: R² has no meaning then.

    Examples
    --------
    >>> compute_r_squared([1.0, 2.0, 3.0], [1.0, 2.0, 2.0])
    0.5
    """
    total = compute_total_sum_of_squares(measured)
    if total == 0.0:
        raise InputError("R² needs measured values that differ from each other; all of them are the same.")
    return 1.0 - compute_sum_squared_error(measured, fitted) / total


def compute_differential_mae(measured: npt.ArrayLike, truth: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Compute the mean absolute error of differences from a reference position.

        MAE_diff = 1/(kn) sum |d - (f + mean d_ref)|        (Eq. S25)

    Parameters
    ----------
    measured : array_like, shape (k,) or (k, n)
    truth : array_like, shape (k,) or (k, n)
        True differences from the reference position, such as a stage's readings.
    reference : array_like, any shape
        Values measured at the reference position.

    Returns
    -------
    float, in the unit of the data

    Examples
    --------
    >>> compute_differential_mae([11.0, 12.5], [1.0, 2.0], [9.0, 11.0])
    0.25
    """
    d, f = _as_dataset_pair(measured, truth)
    return float(np.mean(np.abs(d - (f + _as_datasets(reference, "reference").mean()))))


def compute_standard_deviation(measured: npt.ArrayLike) -> float:
    """Compute the standard deviation about each dataset's own mean.

        sigma = sqrt(1/(kn - 1) sum_j sum_i (mean d_j - d_ij)²)        (Eq. S26)

    Parameters
    ----------
    measured : array_like, shape (k,) or (k, n)

    Returns
    -------
    float, in the unit of the data

    Raises
    ------
    InputError
        For fewer than two values.

    Examples
    --------
    >>> round(compute_standard_deviation([[0.0, 10.0], [2.0, 12.0]]), 4)  # two datasets that scatter alike
    1.1547
    """
    d = _as_datasets(measured, "measured")
    if d.size < 2:
        raise InputError(f"A standard deviation needs at least two values; got {d.size}.")
    return float(np.sqrt(np.sum((d - d.mean(axis=0)) ** 2) / (d.size - 1)))


def compute_circular_mean(angles: npt.ArrayLike) -> float:
    """Compute the mean direction over all values as one dataset.

        mean = arg(sum exp(i d))        (Eq. S30)

    Parameters
    ----------
    angles : array_like, shape (k,) or (k, n), in rad

    Returns
    -------
    float, in rad
        Within (-pi, pi].

    Raises
    ------
    InputError
        If the directions cancel, so that they have no mean.

    Examples
    --------
    >>> round(float(np.degrees(compute_circular_mean(np.radians([350.0, 10.0, 30.0])))), 9)
    10.0
    """
    total = np.sum(np.exp(1j * _as_datasets(angles, "angles"))) / np.size(angles)
    if abs(total) < NO_DIRECTION:
        raise InputError("These directions cancel each other; they have no mean.")
    return float(np.angle(total))


def compute_differential_circular_mae(measured: npt.ArrayLike, truth: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Compute the mean absolute error of turns from a reference direction.

        MAE = arg(sum exp(i |w(d - (f + mean d_ref))|)),   w: wrapped to (-pi, pi]        (Eq. S27)

    Without w, an error of -1 deg that is written 359 deg would count as -1 deg and cancel one of +1 deg.

    Parameters
    ----------
    measured, truth : array_like, shape (k,) or (k, n), in rad
    reference : array_like, in rad
        Directions measured at the reference position; their circular mean counts (Eq. S30).

    Returns
    -------
    float, in rad
        Within 0 to pi.

    Examples
    --------
    >>> turns = np.radians([1.0, 91.0, 179.0, 271.0])
    >>> error = compute_differential_circular_mae(turns, np.radians([0, 90, 180, 270]), [0.0])
    >>> round(float(np.degrees(error)), 9)
    1.0
    """
    d, f = _as_dataset_pair(measured, truth)
    off = wrap_angles(d - (f + compute_circular_mean(reference)))
    return float(np.angle(np.sum(np.exp(1j * np.abs(off)))))


def compute_circular_standard_deviation(angles: npt.ArrayLike) -> float:
    """Compute the standard deviation of directions about each dataset's own circular mean.

        sigma = sqrt(-2 ln R),   R = 1/(kn) |sum_j sum_i exp(i (mean d_j - d_ij))|        (Eqs. S28, S29)

    Parameters
    ----------
    angles : array_like, shape (k,) or (k, n), in rad

    Returns
    -------
    float, in rad
        Infinite where R is 0: directions without any preference.

    Examples
    --------
    >>> round(float(np.degrees(compute_circular_standard_deviation(np.radians([358.0, 0.0, 2.0])))), 3)
    1.633
    """
    d = _as_datasets(angles, "angles")
    means = np.array([compute_circular_mean(column) for column in d.T])
    length = min(float(np.abs(np.mean(np.exp(1j * (means - d))))), 1.0)
    return float(np.sqrt(-2.0 * np.log(length))) if length > 0.0 else np.inf


def wrap_angles(angles: npt.ArrayLike) -> FloatArray:
    """Wrap angles to (-pi, pi].

    Parameters
    ----------
    angles : array_like, in rad

    Returns
    -------
    ndarray, same shape, in rad
    """
    turned: FloatArray = np.pi - np.mod(np.pi - np.asarray(angles, dtype=np.float64), 2.0 * np.pi)
    return turned


def _as_datasets(values: npt.ArrayLike, name: str) -> FloatArray:
    """Convert values to a finite array (k, n) of at least one value."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers; got {values!r}.") from error
    if array.ndim > 2 or array.size == 0:
        raise InputError(f"{name} must have shape (k,) or (k, n) with at least one value; got {array.shape}.")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name} must be finite; entry {where} is {array[where]}.")
    return array.reshape(len(array), -1) if array.ndim else array.reshape(1, 1)


def _as_dataset_pair(measured: npt.ArrayLike, truth: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Convert both to (k, n); one dataset of truth serves all datasets of measured values."""
    d, f = _as_datasets(measured, "measured"), _as_datasets(truth, "truth")
    if len(f) != len(d) or f.shape[1] not in (1, d.shape[1]):
        raise InputError(f"measured has shape {d.shape} and truth {f.shape}; they must match, or truth be (k,).")
    return d, f
