"""The bench: a `smolbot.core.rig.Rig` with a data acquisition card, relays and a magnet stage."""

from __future__ import annotations

import contextlib
import math
import time
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.bench.hardware.card import Card, LostWindow
from smolbot.bench.hardware.driver import Driver
from smolbot.bench.hardware.guard import Guard
from smolbot.bench.hardware.magnet import Magnet
from smolbot.bench.hardware.priority import raise_priority
from smolbot.bench.hardware.relay_probe import make_relay_probe
from smolbot.bench.hardware.supply import Supply
from smolbot.bench.hardware.waveform import Waveform, WaveformCompiler
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.config.nominal_excitation import NominalExcitation
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.core.closeable import Closeable
from smolbot.core.coil_probe import BASELINE_DURATION, Probe, make_probe_shot
from smolbot.core.rig import CheckItem, ProvenanceReporter, Witness
from smolbot.core.sensing import Recording
from smolbot.core.shots import MoveMagnet, Rest, Rotate, Shot, is_magnet_near_after
from smolbot.errors import RigError

if TYPE_CHECKING:
    from smolbot.bench.hardware.remote_witness import RemoteWitness
    from smolbot.core.operator import Operator

MAX_LOST_IN_A_ROW = 2
"""Number of lost windows in a row that ends the run: a card that fails twice has failed for good."""


class BenchRig(Closeable):
    """A rig of real devices, or of a twin that speaks the same protocols.

    Parameters
    ----------
    rig : RigConfig
    section : BenchSection
    operator : Operator

    Attributes
    ----------
    sensors : SensorArray
        As the rig file describes them.
    limits : Limits
    witness : Witness or None
        Ground truth of a twin on the same machine; None on a real bench.
    recovered : Counter
        Number of faults by name that it has recovered from.

    Raises
    ------
    RigError
        One line for every device that cannot be opened; nothing was energised.
    """

    def __init__(self, rig: RigConfig, section: BenchSection, operator: Operator) -> None:
        self.sensors, self.limits = rig.sensors, rig.limits
        self.witness: Witness | None = None
        self._truth: RemoteWitness | None = None
        self.recovered: Counter[str] = Counter()
        self._rig, self._section = rig, section
        self._rate, self._gains = rig.sample_rate, rig.sensor_gains[:, None]
        self._volts_per_tesla = rig.sections.sensors.volts_per_tesla
        self._range = rig.sections.sensors.range
        self._compiler = WaveformCompiler(
            section, rig.coil_names, self._rate, dict(zip(rig.driven, rig.time_constants, strict=True))
        )
        self._excitation = NominalExcitation(rig)
        self._epoch = time.monotonic()
        self._drive_end: float | None = None
        self._lost = 0
        self._latched: RigError | None = None
        self._driver: Driver | None = None
        self._card: Card | None = None
        self._guard: Guard | None = None
        self._magnet: Magnet | None = None
        self._supply: Supply | None = None
        self._open = True
        try:
            self._open_devices(operator)
        except BaseException:
            self.close()
            raise

    def _open_devices(self, operator: Operator) -> None:
        section, faults = self._section, []
        raise_priority()
        try:
            self._driver = Driver(section.server, section.call_timeout)
            self._card = Card(section, self._rate, self._driver)
            self._guard = Guard(section, self._driver, self._trip)
            self._guard.open()
        except (RigError, LostWindow) as error:
            faults.append(f"card {section.device}: {error}")
        if section.stage is not None:
            try:
                self._magnet = Magnet(self._rig.magnet, section.stage, section.operator, operator)
            except RigError as error:
                faults.append(str(error) if str(error).startswith("magnet stage") else f"magnet stage: {error}")
        if section.supply is not None:
            try:
                self._supply = Supply(section.supply)
                self._supply.configure()
            except RigError as error:
                faults.append(str(error))
        if section.truth and not faults:
            from smolbot.bench.hardware.remote_witness import RemoteWitness

            try:
                self.witness = self._truth = RemoteWitness(section.truth, self._epoch)
            except (RigError, OSError) as error:
                faults.append(f"truth of the twin at {section.truth}: {error}")
        if faults:
            raise RigError("\n".join([*faults, f"'{self._rig.name}' was not opened; nothing was energised."]))
        if self._supply is not None:
            self._supply.switch_on()

    def now(self) -> float:
        """Return the time since the bench was opened. A shot that is played now starts some milliseconds later.

        Returns
        -------
        float, in s
        """
        return time.monotonic() - self._epoch

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Recording or None
            None if the shot does not listen, or if its window was lost; `recovered` counts the latter.

        Raises
        ------
        InterlockError
            Before anything moves, if the shot breaks a limit.
        RigError
            If a device fails, or the bench was stopped; every output is at zero and every relay open.
        """
        self._refuse_if_stopped()
        near = self._magnet is not None and self._magnet.near
        self.limits.check(shot, magnet_near=near)
        try:
            if any(isinstance(window, Rotate | MoveMagnet) for window in shot.windows):
                assert self._magnet is not None  # no other rig's limits let such a window pass
                self._magnet.play(shot, self._refuse_if_stopped)
                self.recovered.update(self._magnet.take_recovered())
                return None
            return self._play_electrical(shot)
        except RigError as error:
            self._halt(error)
            raise self._latched or error from error
        finally:
            if self._magnet is not None and not self._magnet.has_switches:
                self._magnet.near = is_magnet_near_after(shot, near=near)

    def probe(self, coil: str, current: float) -> Probe:
        """Record the sensors while the relay of one coil closes and opens again.

        Parameters
        ----------
        coil : str
            Such as ``+x`` or ``excitation x``.
        current : float, in A

        Returns
        -------
        Probe

        Raises
        ------
        InterlockError
            Before anything is driven, if the current breaks a limit.
        RigError
            If a device fails, a sample is lost, or the bench was stopped; every output is at zero and every relay
            open.
        """
        self._refuse_if_stopped()
        near = self._magnet is not None and self._magnet.near
        self.limits.check(make_probe_shot(self.limits, coil, current), magnet_near=near)
        waveform, on, off = make_relay_probe(self._section, coil, current, self._rate)
        assert self._card is not None
        assert self._guard is not None
        try:
            if self._magnet is not None:
                self._magnet.check_at_rest()
            volts, began = self._card.play(waveform, self._guard)
        except (RigError, LostWindow) as error:
            reason = (
                error
                if isinstance(error, RigError)
                else RigError(f"The probe of {coil} was lost: {error}", channel=coil)
            )
            self._halt(reason)
            raise self._latched or reason from error
        recording = self._make_recording(Shot((Rest(BASELINE_DURATION),)), waveform, volts, began - self._epoch)
        assert recording is not None
        relays = self._section.relays
        return Probe(recording, on, off, relays.closing, relays.opening)

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Compute the nominal field of each excitation coil.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            In the world frame.

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A
            In the world frame.
        """
        return self._excitation.compute_field(as_floats(position, (3,), "excitation_field position"))

    def stop(self) -> None:
        """Bring every output to zero now, for good. Safe from any thread, any number of times."""
        self._halt(RigError("This bench was stopped; open it anew. Every output is at zero."))

    def close(self) -> None:
        """Stop, then close every device; harmless when repeated."""
        if not self._open:
            return
        self._open = False
        self.stop()
        for part in (self._guard, self._card, self._magnet, self._supply, self._truth, self._driver):
            if part is not None:
                with contextlib.suppress(RigError):  # a device that is gone keeps no other from being let go
                    part.close()

    @property
    def status_line(self) -> str:
        """The faults that it has recovered from so far, in a few words."""
        return ", ".join(f"{count} {what}" for what, count in sorted(self.recovered.items()))

    def checks(self) -> Iterator[CheckItem]:
        """Read back every device; nothing is driven.

        Yields
        ------
        CheckItem
        """
        section = self._section
        card = f"card {section.device}"
        if self._card is not None and self._guard is not None:
            yield CheckItem(card, "product", self._card.product, True, section.product)
            yield CheckItem(card, "serial number", self._card.serial)
            yield from self._guard.checks(card)
        if self._magnet is not None:
            yield from self._magnet.checks()
        if self._supply is not None:
            yield CheckItem("power supply", "model", str(self._supply.identity))
            on = self._supply.is_on
            yield CheckItem("power supply", "outputs", "on" if on else "off", on, "on")
            wrong = self._supply.find_differences()
            yield CheckItem("power supply", "settings", " ".join(wrong) or "as in the rig file", not wrong)

    def provenance(self) -> dict[str, Any]:
        """Return what the devices report about themselves, and for a twin the parameters that it has sampled.

        Returns
        -------
        dict
        """
        found: dict[str, Any] = {"device": self._section.device, "server": self._section.server or "local driver"}
        if self._card is not None:
            found |= {"product": self._card.product, "serial": self._card.serial}
        if self._magnet is not None:
            found["magnet_stage"] = self._magnet.identity
        if self._supply is not None:
            found["supply"] = str(self._supply.identity)
        return found | {"twin": self.witness.provenance()} if isinstance(self.witness, ProvenanceReporter) else found

    def _play_electrical(self, shot: Shot) -> Recording | None:
        assert self._card is not None
        assert self._guard is not None
        if self._magnet is not None:
            self._magnet.check_at_rest()
        waveform = self._compiler.compile(shot)
        try:
            if self._lost:  # before anything is driven again
                self._card.test_inputs()
            volts, began = self._card.play(waveform, self._guard)
        except LostWindow as error:
            self._count_lost(str(error))
            return None
        self._lost = 0
        return self._make_recording(shot, waveform, volts, began - self._epoch)

    def _count_lost(self, what: str) -> None:
        self._refuse_if_stopped()
        self._lost += 1
        if self._lost >= MAX_LOST_IN_A_ROW:
            raise RigError(
                f"{self._section.device}: {self._lost} windows in a row were lost: {what}", device=self._section.device
            )
        self.recovered["lost windows"] += 1

    def _make_recording(
        self, shot: Shot, waveform: Waveform, volts: FloatArray | None, began: float
    ) -> Recording | None:
        if waveform.drive_end is not None:
            self._drive_end = began + waveform.drive_end
        if volts is None or waveform.listen is None:
            return None
        field = volts / self._volts_per_tesla
        clock = began + waveform.listen[0] / self._rate
        drive = shot.excite
        since = clock - self._drive_end if drive is not None and self._drive_end is not None else math.inf
        full = min(self._range, self._section.inputs.range_v / self._volts_per_tesla)
        saturated = np.abs(field).max(axis=1) >= full * (1.0 - 2.0**-14)
        return Recording(field / self._gains, self._rate, since, saturated, drive, clock)

    def _trip(self, reason: RigError) -> None:
        """Stop the bench for a reason that the guard gives, from its own thread."""
        self._halt(reason)

    def _halt(self, reason: RigError) -> None:
        """Store the first reason and bring everything to zero; if the card fails, its watchdog opens the relays."""
        if self._latched is None:
            self._latched = reason
        if self._card is not None and not self._card.stop() and self._guard is not None:
            self._guard.abandon()
        if self._magnet is not None:
            self._magnet.stop()
        if self._supply is not None:
            with contextlib.suppress(RigError):  # nothing is driven any more, whether it receives this or not
                self._supply.switch_off()

    def _refuse_if_stopped(self) -> None:
        if self._latched is not None:
            raise self._latched
