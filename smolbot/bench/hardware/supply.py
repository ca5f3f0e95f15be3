"""The coils' power supply (R&S NGP800 class): limits are set and read back before an output is switched on."""

from __future__ import annotations

from dataclasses import dataclass

from smolbot.bench.hardware.scpi import Permit, ScpiSocket
from smolbot.bench.hardware.supply_section import SupplyChannelSection, SupplySection
from smolbot.errors import RigError

RESOLUTION = 1e-3
"""Resolution of the supply's voltages and currents, in V and A; values read back deviate by up to half of it."""


@dataclass(frozen=True)
class SupplyIdentity:
    """Answer of a supply to ``*IDN?``.

    Attributes
    ----------
    maker : str
    model : str
    serial : str
    firmware : str
    """

    maker: str
    model: str
    serial: str
    firmware: str

    def __str__(self) -> str:
        return f"{self.maker} {self.model}, serial number {self.serial}, firmware {self.firmware}"


@dataclass(frozen=True)
class ChannelState:
    """Settings and measurements of one channel.

    Attributes
    ----------
    channel : int
        From 1.
    voltage : float, in V
    current : float, in A
        Current limit.
    ovp : float, in V
        Level of the over-voltage protection.
    ovp_on : bool
    fuse_on : bool
    selected : bool
        Whether it follows the common output switch.
    measured_voltage : float, in V
    measured_current : float, in A
    """

    channel: int
    voltage: float
    current: float
    ovp: float
    ovp_on: bool
    fuse_on: bool
    selected: bool
    measured_voltage: float
    measured_current: float


class Supply:
    """A power supply whose channels are set from the rig file.

    Every output is off when it is opened, and stays off until `switch_on`.

    Parameters
    ----------
    section : SupplySection

    Attributes
    ----------
    identity : SupplyIdentity

    Raises
    ------
    RigError
        If it does not answer, is another model, or lacks a channel; the message has device, address and action.
    """

    def __init__(self, section: SupplySection) -> None:
        self._section = section
        self._name = f"power supply at {section.where}"
        self._scpi = ScpiSocket(self._name, section.address, section.timeout)
        self._times_off = 0  # number of commands to switch off
        self._set_after = -1  # how often when it was last configured
        self._closed = False
        try:
            self.identity = self._identify()
            self._scpi.clear_errors("clear its error queue")
            self.switch_off()
        except BaseException:
            self._scpi.close()
            raise

    def configure(self) -> None:
        """Set voltage, current, over-voltage protection and fuse of every channel, and check them by reading back.

        Only the channels of the rig file follow the output switch afterwards.

        Raises
        ------
        RigError
            If a setting is refused, or reads back as another.
        """
        offs = self._times_off
        channels = {channel.channel: channel for channel in self._section.channels}
        for number in range(1, self.channel_count + 1):
            if number in channels:
                self._set_channel(channels[number])
            else:
                self._command_channel(number, "OUTP:SEL 0", action=f"leave channel {number} off")
        faults = self.find_differences()
        if faults:
            raise self._fault(f"does not read back as set: {' '.join(faults)}")
        self._set_after = offs

    def switch_on(self) -> None:
        """Switch the outputs on; only after `configure`, and not if they were switched off since.

        Raises
        ------
        RigError
            If that is so, or if the supply does not report that it is on.
        """
        if not self._switch("OUTP:GEN 1", "switch the outputs on", self._refuse_unless_set):
            raise self._fault("was commanded to switch the outputs on; it reports that they are off.")

    def switch_off(self) -> None:
        """Switch every output off, until the supply is configured anew. Safe from any thread, any number of times.

        Waits only for the exchange that another thread has begun.

        Raises
        ------
        RigError
            If it cannot be reached or reports that outputs are on: then they may be.
        """
        self._times_off += 1
        try:
            still_on = self._switch("OUTP:GEN 0", "switch the outputs off")
        except RigError:  # the connection may be what failed: once more, over a new one
            still_on = self._switch("OUTP:GEN 0", "switch the outputs off (they may be on)")
        if still_on:
            raise self._fault("was commanded to switch the outputs off; it reports that they are on.")

    @property
    def is_on(self) -> bool:
        """Whether the outputs' common switch is on."""
        return self._query_flag("OUTP:GEN?", "read the output switch")

    @property
    def channel_count(self) -> int:
        """Number of channels of this model: the last digit of its name."""
        return int(self.identity.model[-1])

    def read_back(self) -> tuple[ChannelState, ...]:
        """Read settings and measurements of every channel of the rig file.

        Returns
        -------
        tuple of ChannelState
        """
        return tuple(self._read_channel(channel.channel) for channel in self._section.channels)

    def find_differences(self) -> list[str]:
        """Compare the settings of the supply with the rig file.

        Returns
        -------
        list of str
            A sentence for each difference; empty if there is none.
        """
        expected = {channel.channel: channel for channel in self._section.channels}
        return [
            fault
            for state in self.read_back()
            for fault in self._find_channel_differences(expected[state.channel], state)
        ]

    def close(self) -> None:
        """Switch off and close the connection; harmless when repeated.

        Raises
        ------
        RigError
            If it cannot be switched off; the connection is closed all the same.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.switch_off()
        finally:
            self._scpi.close()

    def _identify(self) -> SupplyIdentity:
        action = "identify it"
        parts = [part.strip() for part in self._scpi.send_query("*IDN?", action).split(",")]
        if len(parts) != 4:
            raise self._fault(f"cannot {action}: it answers *IDN? with '{','.join(parts)}'.")
        found = SupplyIdentity(*parts)
        if not found.model.upper().startswith(self._section.model.upper()) or not found.model[-1:].isdigit():
            raise self._fault(
                f"is a {found.maker} {found.model}; the rig file says bench.supply.model = "
                f"'{self._section.model}'. Nothing was switched on."
            )
        highest = max(channel.channel for channel in self._section.channels)
        if highest > int(found.model[-1]):
            raise self._fault(f"is a {found.model} with {found.model[-1]} channels; the rig file sets {highest}.")
        return found

    def _set_channel(self, channel: SupplyChannelSection) -> None:
        number, name = channel.channel, channel.name
        # Protection comes first: a voltage is never set that nothing guards.
        for command, what in (
            (f"VOLT:PROT:LEV {channel.ovp_v:.3f}", f"{channel.ovp_v:g} V of over-voltage protection"),
            ("VOLT:PROT 1", "over-voltage protection"),
            (f"VOLT {channel.voltage_v:.3f}", f"{channel.voltage_v:g} V"),
            (f"CURR {channel.current_a:.3f}", f"{channel.current_a:g} A"),
            (f"FUSE {int(channel.fuse)}", f"fuse {'on' if channel.fuse else 'off'}"),
            ("OUTP:SEL 1", "following the output switch"),
        ):
            self._command_channel(number, command, action=f"set {name} to {what}")

    def _refuse_unless_set(self) -> None:
        if self._set_after != self._times_off:
            why = (
                "its channels were not set"
                if self._set_after < 0
                else "it was switched off since its channels were set"
            )
            raise self._fault(f"cannot switch the outputs on: {why}.")

    def _fault(self, what: str) -> RigError:
        return RigError(f"{self._name}: {what}", device=self._name)

    def _switch(self, command: str, action: str, permit: Permit | None = None) -> bool:
        """Set the common output switch; return its state as read back."""
        query = "OUTP:GEN?"
        return self._parse_flag(
            self._scpi.send_commands(command, action=action, permit=permit, then=query), query, action
        )

    def _command_channel(self, number: int, command: str, *, action: str) -> None:
        self._scpi.send_commands(f"INST:NSEL {number}", command, action=action)

    def _read_channel(self, number: int) -> ChannelState:
        action = f"read back channel {number}"
        self._scpi.send_commands(f"INST:NSEL {number}", action=action)
        return ChannelState(
            channel=number,
            voltage=self._query_number("VOLT?", action),
            current=self._query_number("CURR?", action),
            ovp=self._query_number("VOLT:PROT:LEV?", action),
            ovp_on=self._query_flag("VOLT:PROT?", action),
            fuse_on=self._query_flag("FUSE?", action),
            selected=self._query_flag("OUTP:SEL?", action),
            measured_voltage=self._query_number("MEAS:VOLT?", action),
            measured_current=self._query_number("MEAS:CURR?", action),
        )

    def _query_number(self, query: str, action: str) -> float:
        answer = self._scpi.send_query(query, action)
        try:
            return float(answer)
        except ValueError:
            raise self._fault(f"cannot {action}: it answers {query} with '{answer}', not a number.") from None

    def _query_flag(self, query: str, action: str) -> bool:
        return self._parse_flag(self._scpi.send_query(query, action), query, action)

    def _parse_flag(self, answer: str, query: str, action: str) -> bool:
        if answer.upper() not in ("0", "1", "ON", "OFF"):
            raise self._fault(f"cannot {action}: it answers {query} with '{answer}', not 0 or 1.")
        return answer.upper() in ("1", "ON")

    @staticmethod
    def _find_channel_differences(section: SupplyChannelSection, state: ChannelState) -> list[str]:
        pairs = (
            ("voltage", section.voltage_v, state.voltage, "V"),
            ("current", section.current_a, state.current, "A"),
            ("over-voltage protection", section.ovp_v, state.ovp, "V"),
        )
        found = [
            f"{section.name}: {what} is {is_:g} {unit}, not {should:g} {unit}."
            for what, should, is_, unit in pairs
            if abs(is_ - should) > RESOLUTION
        ]
        if not state.ovp_on:
            found.append(f"{section.name}: its over-voltage protection is off.")
        if state.fuse_on != section.fuse:
            found.append(f"{section.name}: its fuse is {'on' if state.fuse_on else 'off'}.")
        if not state.selected:
            found.append(f"{section.name}: does not follow the output switch.")
        return found
