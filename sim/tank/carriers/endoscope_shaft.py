"""The endoscope's own magnetisation: a chain of magnetic poles along the shaft behind the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.tank.carriers.endoscope_operator import EndoscopeOperator
from sim.tank.settings import ShaftSection
from smolbot.core.arrays import FloatArray

FIELD_STEP = 2e-3  # s: between two computed fields; linear between them, as tremor has a period of 0.1 s
MU_0_OVER_4_PI = 1e-7  # T·m/A
POLES_PER_FIELD = 1e7  # A·m per T·m²: 4 pi / mu_0
SIZE_SCATTER, MAX_SIGMAS = 0.2, 2.0  # relative standard deviation of a shaft's fields, and where it is clipped
STREAM = 5  # random stream of a seed for the shaft


@dataclass(frozen=True, eq=False)
class EndoscopeShaft:
    """Straight pieces, each magnetised along its length with its own strength: equivalent to poles at their ends.

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
    def sample(cls, section: ShaftSection, seed: int, l0: float) -> EndoscopeShaft:
        """Sample a shaft.

        The strongest pole makes the section's `surface_ut` at the shaft's surface, the tip's pole `tip_ut` at the
        magnet.

        Parameters
        ----------
        section : ShaftSection
        seed : int
        l0 : float, in m
            From the cantilever's rotation centre to the magnet.

        Returns
        -------
        EndoscopeShaft
        """
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, STREAM])))
        away = float(rng.uniform(-np.pi, np.pi))
        side = section.radius * np.array([np.cos(away), np.sin(away), 0.0])
        size = 1.0 + SIZE_SCATTER * np.clip(rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)
        at_tip, at_surface = section.compute_fields(size)
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

    def compute_field_at_magnet(self, l0: float) -> FloatArray:
        """Compute the field at the magnet, from the tip's pole only, which is by far the nearest.

        Parameters
        ----------
        l0 : float, in m
            From the cantilever's rotation centre to the magnet.

        Returns
        -------
        ndarray, shape (3,), in T
            Body frame.
        """
        away = np.array([0.0, 0.0, l0]) - self.side
        return np.asarray(MU_0_OVER_4_PI * self.poles[0] * away / np.linalg.norm(away) ** 3)

    def compute_field(self, operator: EndoscopeOperator, times: FloatArray, points: FloatArray) -> FloatArray:
        """Compute the shaft's field.

        Parameters
        ----------
        operator : EndoscopeOperator
        times : ndarray, shape (n,), in s
            On the tank's clock.
        points : ndarray, shape (m, 3), in m
            World frame.

        Returns
        -------
        ndarray, shape (m, n, 3), in T
            World frame.
        """
        places = operator.compute_shaft_positions(times, self.distances)
        away = points[:, None, None, :] - places
        return np.asarray(
            MU_0_OVER_4_PI * np.einsum("k,mnki->mni", self.poles, away / np.linalg.norm(away, axis=3)[..., None] ** 3)
        )

    def compute_sensor_field(
        self,
        operator: EndoscopeOperator,
        clock: float,
        n: int,
        rate: float,
        delay: float,
        points: FloatArray,
        axes: FloatArray,
    ) -> FloatArray:
        """Compute the shaft's field along the sensors' axes.

        Parameters
        ----------
        operator : EndoscopeOperator
        clock : float, in s
            Time of the first sample.
        n : int
            Number of samples.
        rate : float, in Hz
        delay : float, in s
            Time constant of the sensors' low pass; so slow a field is only delayed by it.
        points, axes : ndarray, shape (m, 3)
            Positions (m) and sensitive directions of the sensors, world frame.

        Returns
        -------
        ndarray, shape (m, n), in T
        """
        span = (n - 1) / rate
        grid = np.linspace(clock, clock + span, max(int(np.ceil(span / FIELD_STEP)), 1) + 1)
        along = np.einsum("mni,mi->mn", self.compute_field(operator, grid - delay, points), axes)
        times = clock + np.arange(n) / rate
        return np.stack([np.interp(times, grid, row) for row in along])
