"""Poses from a world that skips the signals: what takes a localizer's place in the loop there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.localizer import MAX_SIGMA, MIN_AMPLITUDE, MIN_R_SQUARED, Localizer
from smolbot.poses import Pose
from smolbot.rotations import quaternion_product
from smolbot.sensing import Device, Recording, SensorArray

_HALF_TURN = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class SightedSwing:
    """Amplitude of the oscillation in rad, and its covariance (7, 7) with the pose; see `localizer.Swing`."""

    amplitude: float
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Sighting(Recording):
    """A recording whose samples were never made: it carries the fit that a localizer would have come to.

    Attributes
    ----------
    pose : Pose or None
        With every error of a fit already in it; its claim to be trusted is not yet judged.
    swing : SightedSwing or None
    """

    pose: Pose | None = None
    swing: SightedSwing | None = None


@dataclass(frozen=True)
class Sightings:
    """Takes `Localizer`'s place where a rig hands out sightings. It holds no truth: all it knows is in a sighting.

    Attributes
    ----------
    sensors, device, volume
        As the localizer believes in them.
    time_constants : tuple of float, in s
        Of the excitation coils' ring-down, as they are believed to be: there is no signal to learn them from.
    """

    sensors: SensorArray
    device: Device
    volume: SearchVolume
    time_constants: tuple[float, ...] = ()

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, SightedSwing]:
        """Pose and swing of a sighting, judged by the rules of `Localizer`; depends on its arguments alone.

        Parameters
        ----------
        prior : Pose, optional
            Of the two orientations that sound alike, the one nearer to it is returned.

        Raises
        ------
        InputError
            Where nothing was seen, as with a recording that has too few usable channels.
        """
        pose, swing = getattr(recording, "pose", None), getattr(recording, "swing", None)
        if pose is None or swing is None:
            raise InputError("This recording holds no pose: nothing was driven before it.")
        if prior is not None:
            twin = quaternion_product(pose.orientation, _HALF_TURN)
            if abs(twin @ prior.orientation) > abs(pose.orientation @ prior.orientation):
                pose = replace(pose, orientation=twin)
        return replace(pose, trusted=self._believable(pose, swing)), swing

    def _believable(self, pose: Pose, swing: SightedSwing) -> bool:
        spread = np.sqrt(np.diag(pose.covariance))
        certain = bool(spread[:3].max() < MAX_SIGMA[0] and spread[3:].max() < MAX_SIGMA[1])
        loud = swing.amplitude > MIN_AMPLITUDE * 1.1 * self.device.theta_max
        low, high = np.array(self.volume.low) - 0.02, np.array(self.volume.high) + 0.02
        inside = bool(np.all((pose.position >= low) & (pose.position <= high)))
        return certain and loud and inside and pose.r_squared >= MIN_R_SQUARED


@runtime_checkable
class SightingRig(Protocol):
    """A rig that makes no signals, but poses with the errors that a localizer's would have."""

    def sightings(self, localizer: Localizer) -> Sightings:
        """What takes the place of `localizer`; from now on the rig errs as that one would."""
