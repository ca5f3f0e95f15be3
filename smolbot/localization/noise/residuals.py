"""Fit residuals of a recording, channel by channel, compared with the noise model's prediction.

Each channel's residual is compared with the prediction from the other channels. Mains noise, which all channels
measure, is predicted, so that an increase of one sensor's own noise is detected.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.localization import kernels as compiled
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.problem import Fit, LinearModel

if TYPE_CHECKING:
    from smolbot.core.sensing import Recording

_kernels: Any = compiled

MAX_BLOCKS = 24
"""Blocks of a recording that are used: the first ones of a long recording."""

NO_FREEDOM = 1e-9
"""Singular value, relative to the largest, below which a free function depends on the others."""

REGULARISATION = 1e-9
"""Share of the mean variance added to a covariance before it is inverted."""


@lru_cache(maxsize=4)
def _compute_channel_whitener(model: LinearModel, noise: NoiseModel, block: float) -> tuple[FloatArray, FloatArray]:
    """Compute each channel's whitener given the others, and the signals in blocks.

    Shapes are (n_channels * n_left, n_channels * n_blocks) and (n_channels * n_blocks, n_functions, n_channels).
    """
    n = int(model.used.sum())
    n_blocks = min(len(model.chain.first), MAX_BLOCKS)
    slope = np.linspace(-1.0, 1.0, n_blocks)
    free = np.column_stack([np.ones(n_blocks), slope, model.free[:n_blocks]])
    left, values, _ = np.linalg.svd(free, full_matrices=True)
    kept = left[:, int(np.sum(values > NO_FREEDOM * values[0])) :]
    rows = np.repeat(model.used, n_blocks)
    covariance = noise.covariance(n_blocks, block)[np.ix_(rows, rows)].reshape(n, n_blocks, n, n_blocks)
    # each channel given all others: whitened by its block of the precision matrix
    middle = np.einsum("ta,itju,ub->iajb", kept, covariance, kept, optimize=True)
    m = kept.shape[1]
    flat = middle.reshape(n * m, n * m)
    precision = np.linalg.inv(flat + REGULARISATION * np.trace(flat) / len(flat) * np.eye(len(flat)))
    out = np.empty((n, m, n * n_blocks))
    for j in range(n):
        own = slice(j * m, (j + 1) * m)
        factor = np.linalg.cholesky(precision[own, own])
        whitened = np.linalg.solve(factor, precision[own]).reshape(m, n, m)
        out[j] = np.einsum("rjb,tb->rjt", whitened, kept).reshape(m, -1)
    responses = np.zeros((n * n_blocks, len(model.functions), n))
    for j in range(n):
        responses[j * n_blocks : (j + 1) * n_blocks, :, j] = model.functions[:, :n_blocks].T
    return np.ascontiguousarray(out.reshape(n * m, -1)), responses


def compute_energies(
    model: LinearModel, fit: Fit, recording: Recording, noise: NoiseModel
) -> tuple[FloatArray, FloatArray]:
    """Compute the energy of the fit residuals in each channel, in units of the noise, and its expectation.

    Parameters
    ----------
    model : LinearModel
    fit : Fit
    recording : Recording
    noise : NoiseModel

    Returns
    -------
    found, expected : ndarray, shape (n_sensors,)
        Both zero for sensors that took no part. For noise as predicted, `found` is `expected` on average, with a
        variance of twice that.
    """
    whiten, responses = _compute_channel_whitener(
        model.array_independent, noise, model.chain.weights.shape[1] / recording.sample_rate
    )
    n = len(model.positions)
    n_blocks = whiten.shape[1] // n
    place = (fit.position, fit.rotation, fit.phase, fit.amplitude)
    signal, jacobian = model.compute_response(*place, matrix=responses)
    field = np.ascontiguousarray(recording.field[model.used])
    blocks = _kernels.apply_taps(field, model.chain.first, model.chain.weights)[:, :n_blocks]
    left = whiten @ (blocks.reshape(-1) - signal)
    # degrees of freedom that the fit has used
    taken = np.linalg.solve(np.linalg.cholesky(fit.normal), (whiten @ jacobian).T)
    found, expected = np.zeros(len(model.used)), np.zeros(len(model.used))
    found[model.used] = np.sum(left.reshape(n, -1) ** 2, axis=1)
    expected[model.used] = whiten.shape[0] / n - np.sum(taken.reshape(compiled.N_PARAMETERS, n, -1) ** 2, axis=(0, 2))
    return found, expected
