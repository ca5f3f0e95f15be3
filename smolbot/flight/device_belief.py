"""The device as a flight assumes it: held in one place, and updated by what is learned."""

from __future__ import annotations

from dataclasses import replace

from smolbot.core.sensing import Device
from smolbot.motion.robot import compute_magnet_inertia


class DeviceBelief:
    """The device as a flight assumes it, with what is learned about it in flight.

    When the parts of a flight use a learned value:

    ==============================  ========================  =====================================
    part                            moment, l0                frequency, damping
    ==============================  ========================  =====================================
    pose estimator (`device`)       at once                   at once
    resonance filter (`device`)     at once                   at once
    scheduler (`scheduled`)         with the next retune      at once: learning them is a retune
    scheduler's `inertia`           never                     does not depend on them
    tracker                         uses stop and direction of the moment, which no flight learns
    ==============================  ========================  =====================================

    An estimator is immutable, so the loop makes a new one after every change; the other parts read this object.

    Parameters
    ----------
    device : Device
        As described by the mission's files.

    Attributes
    ----------
    device : Device
        With everything that was learned.
    scheduled : Device
        As of the last retune; drives and listening windows are made for this one.
    inertia : float, in kg·m²
        Of the magnet about the cantilever's rotation centre, from the mission's files.

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
        """Replace moment and lever arm of the device.

        Parameters
        ----------
        moment : float, in A·m²
        l0 : float, in m
            Distance of the magnet from the rotation centre.
        """
        self.device = replace(self.device, moment=moment, l0=l0)

    def retune(self, frequency: float, damping: float) -> None:
        """Replace resonance and damping of the device; from now on shots are made for them.

        Parameters
        ----------
        frequency : float, in Hz
        damping : float, in 1/s
        """
        self.device = self.scheduled = replace(self.device, frequency=frequency, damping=damping)
