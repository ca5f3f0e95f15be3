"""A simulated positioning stage over the tank's sensors, as a lab uses it to calibrate its array."""

from __future__ import annotations

import numpy as np

from sim.tank.settings import TankSettings
from sim.tank.static_bench import StaticBench
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.core.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device, Recording

HOLDER_OFFSET, HOLDER_ROTATION = 1e-4, float(np.radians(0.5))  # m, rad: the device is glued into its holder by hand
STAGE_ERROR = 1e-5  # m, per axis and pose: a good manual or motorised stage
AMPLITUDE_RANGE = (0.6, 0.9)  # amplitude after a drive, as a share of theta_max: unknown, and different each time


class TankStage:
    """The tank's sensors, with a device that a positioning stage holds in known poses.

    The sensors are those that `sim.tank.tank` samples from the same seed. The device is slightly misplaced in its
    holder, the stage has a position error, and each drive leaves another amplitude. All errors scale with the rig
    file's mismatches.

    Parameters
    ----------
    rig : RigConfig
    device : Device
        As assumed.
    seed : int
    """

    def __init__(self, rig: RigConfig, device: Device, seed: int) -> None:
        settings = rig.section_of("tank", TankSettings)
        self._scale = settings.mismatch.scale
        self.bench = StaticBench(rig, device, seed, self._scale)
        self._rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, 3])))
        self.holder: FloatArray = self._scale * np.repeat([HOLDER_OFFSET, HOLDER_ROTATION], 3)
        self.holder *= self._rng.standard_normal(6)

    def record(self, position: FloatArray, orientation: FloatArray, half_periods: int) -> Recording:
        """Return a recording made after a drive, with the holder at a commanded pose.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            Of the holder, world frame.
        orientation : ndarray, shape (4,)
            Unit quaternion of the holder, scalar first.
        half_periods : int
            Length, in half-periods of the assumed frequency.

        Returns
        -------
        Recording
        """
        place = as_floats(position, (3,), "record position")
        turn = as_floats(orientation, (4,), "record orientation")
        missed = self._scale * STAGE_ERROR * self._rng.standard_normal(3)
        true_place = place + missed + matrix_from_quaternion(turn) @ self.holder[:3]
        true_turn = multiply_quaternions(turn, quaternion_from_rotation_vector(self.holder[3:]))
        amplitude = self.bench.true_device.theta_max * float(self._rng.uniform(*AMPLITUDE_RANGE))
        return self.bench.record(true_place, true_turn, half_periods, amplitude=amplitude)
