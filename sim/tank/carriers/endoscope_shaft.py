"""The endoscope's own magnetism: a chain of magnetic poles along the shaft behind the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.tank.carriers.endoscope_hand import Hand
from sim.tank.settings import ShaftSection
from smolbot.core.arrays import FloatArray

GRID = 2e-3  # s: between two computed fields; linear between them, as tremor has a period of 0.1 s
MU_0_OVER_4_PI = 1e-7  # T·m/A
POLES_PER_FIELD = 1e7  # A·m per T·m²: 4 pi / mu_0
SIZE_SCATTER, MAX_SIGMAS = 0.2, 2.0  # relative standard deviation of a shaft's fields, and where it is clipped
STREAM = 5  # random stream of a seed for the shaft


@dataclass(frozen=True, eq=False)
class Shaft:
    """Straight pieces magnetised along their length, each of its own strength: what is left of them are poles.

        B(r) = mu_0 / (4 pi) * sum_k q_k (r - r_k) / |r - r_k|³,   sum_k q_k = 0

    Attributes
    ----------
    poles : ndarray, shape (k,), in A·m
        From the tip on.
    distances : ndarray, shape (k,), in m
        Behind the tip, along the shaft.
    side : ndarray, shape (3,), in m
        From the cantilever's rotation centre to the shaft's axis, body frame: the device is taped onto the tip.
    """

    poles: FloatArray
    distances: FloatArray
    side: FloatArray

    @classmethod
    def draw(cls, section: ShaftSection, seed: int, l0: float) -> Shaft:
        """Draw a shaft: the strongest pole makes `surface_ut` at its surface, the tip's `tip_ut` at the magnet.

        `l0`, in m, is from the cantilever's rotation centre to the magnet.
        """
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, STREAM])))
        away = float(rng.uniform(-np.pi, np.pi))
        side = section.radius * np.array([np.cos(away), np.sin(away), 0.0])
        size = 1.0 + SIZE_SCATTER * np.clip(rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)
        at_tip, at_surface = section.fields(size)
        first, strongest = (
            at_tip * (float(side @ side) + l0**2) * POLES_PER_FIELD,
            at_surface * section.radius**2 * POLES_PER_FIELD,
        )
        pieces = rng.uniform(-1.0, 1.0, section.pieces)
        poles: FloatArray = np.diff(np.concatenate([[0.0], pieces, [0.0]]))
        poles[1:] *= strongest / np.max(np.abs(poles[1:]))
        poles[0] = np.copysign(first, pieces[0])
        poles[-1] -= poles.sum()  # the poles of a magnet sum to zero
        distances: FloatArray = section.piece * np.arange(section.pieces + 1, dtype=np.float64)
        return cls(poles, distances, side)

    def at_magnet(self, l0: float) -> FloatArray:
        """Field (3,) in T at the magnet, body frame: of the tip's pole, which is nearest by far."""
        away = np.array([0.0, 0.0, l0]) - self.side
        return np.asarray(MU_0_OVER_4_PI * self.poles[0] * away / np.linalg.norm(away) ** 3)

    def field(self, hand: Hand, times: FloatArray, points: FloatArray) -> FloatArray:
        """Field (m, n, 3) in T at points (m, 3) in m and times (n,) in s on the tank's clock, world frame."""
        places = hand.behind(times, self.distances)
        away = points[:, None, None, :] - places
        return np.asarray(
            MU_0_OVER_4_PI * np.einsum("k,mnki->mni", self.poles, away / np.linalg.norm(away, axis=3)[..., None] ** 3)
        )

    def heard(
        self, hand: Hand, clock: float, n: int, rate: float, delay: float, points: FloatArray, axes: FloatArray
    ) -> FloatArray:
        """Readings (m, n) in T of sensors at `points` (m, 3) in m along `axes` (m, 3), from `clock` s on.

        `delay`, in s, is the time constant of their low pass, which does no more to so slow a field.
        """
        span = (n - 1) / rate
        grid = np.linspace(clock, clock + span, max(int(np.ceil(span / GRID)), 1) + 1)
        along = np.einsum("mni,mi->mn", self.field(hand, grid - delay, points), axes)
        times = clock + np.arange(n) / rate
        return np.stack([np.interp(times, grid, row) for row in along])
