"""A positioning stage over the tank's sensors: what a lab uses to calibrate its array, simulated."""

from __future__ import annotations

import numpy as np

from sim.tank.settings import TankSettings
from sim.tank.static_bench import StaticBench
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector, quaternion_product
from smolbot.core.sensing import Device, Recording

HOLDER_PLACE, HOLDER_TURN = 1e-4, float(np.radians(0.5))  # m, rad: the device is glued into its holder by hand
STAGE_ERROR = 1e-5  # m, per axis and pose: a good manual or motorised stage
DRIVES = (0.6, 0.9)  # amplitude after a drive, as a share of theta_max: unknown, and different each time


class TankStage:
    """The sensors that `sim.tank.tank` draws from the same seed, with a device that is held in known poses.

    The device sits a little off in its holder, the stage is not perfect, and each drive leaves another
    amplitude. All that scales with the rig file's mismatches.
    """

    def __init__(self, rig: RigConfig, device: Device, seed: int) -> None:
        settings = rig.section_of("tank", TankSettings)
        self._scale = settings.mismatch.scale
        self.bench = StaticBench(rig, device, seed, self._scale)
        self._rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, 3])))
        self.holder: FloatArray = self._scale * np.repeat([HOLDER_PLACE, HOLDER_TURN], 3)
        self.holder *= self._rng.standard_normal(6)

    def record(self, position: FloatArray, orientation: FloatArray, half_periods: int) -> Recording:
        """What the sensors hear after a drive, with the holder at `position` (3,) m and `orientation` (4,)."""
        place = as_floats(position, (3,), "record position")
        turn = as_floats(orientation, (4,), "record orientation")
        missed = self._scale * STAGE_ERROR * self._rng.standard_normal(3)
        true_place = place + missed + matrix_from_quaternion(turn) @ self.holder[:3]
        true_turn = quaternion_product(turn, quaternion_from_rotation_vector(self.holder[3:]))
        amplitude = self.bench.true_device.theta_max * float(self._rng.uniform(*DRIVES))
        return self.bench.record(true_place, true_turn, half_periods, amplitude=amplitude)
