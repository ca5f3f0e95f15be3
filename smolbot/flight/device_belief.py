"""What a flight believes of its device: held in one place, and handed on from there."""

from __future__ import annotations

from dataclasses import replace

from smolbot.core.sensing import Device
from smolbot.motion.robot import compute_magnet_inertia


class DeviceBelief:
    """The one owner of what a flight believes of its device, and of what it learns of it.

    ==============================  ========================  =====================================
    who has it                      moment, l0                frequency, damping
    ==============================  ========================  =====================================
    pose estimator (`device`)       at once                   at once
    resonance filter (`device`)     at once                   at once
    scheduler (`scheduled`)         with the next retune      at once: learning them is a retune
    scheduler's `inertia`           never                     it does not depend on them
    tracker                         uses stop and direction of the moment, which no flight learns
    ==============================  ========================  =====================================

    An estimator is immutable, so the loop makes another one with `device` after every change; the others look here.

    Parameters
    ----------
    device : Device
        As the mission's files have it.

    Attributes
    ----------
    device : Device
        With everything that was learned.
    scheduled : Device
        As of the last retune: drives and listening windows are made for this one.
    inertia : float, in kg·m²
        Of the magnet about the cantilever's rotation centre, as the files have it.

    Examples
    --------
    >>> import numpy as np
    >>> belief = DeviceBelief(Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, 0.31, 103.5, 31.7))
    >>> belief.learn_magnet(0.90e-3, 1.5e-3)
    >>> belief.device.moment, belief.scheduled.moment
    (0.0009, 0.00089)
    >>> belief.retune(103.8, 30.0)
    >>> belief.scheduled.moment, belief.scheduled.frequency
    (0.0009, 103.8)
    """

    def __init__(self, device: Device) -> None:
        self.device = self.scheduled = device
        self.inertia = compute_magnet_inertia(device.moment, device.l0)

    def learn_magnet(self, moment: float, l0: float) -> None:
        """Take in moment, in A·m², and distance of the magnet from the rotation centre, in m."""
        self.device = replace(self.device, moment=moment, l0=l0)

    def retune(self, frequency: float, damping: float) -> None:
        """Take in a resonance, in Hz, and a damping, in 1/s; from now on shots are made for them."""
        self.device = self.scheduled = replace(self.device, frequency=frequency, damping=damping)
