"""The faults that a simulated tank knows, by name, and the check that their channels exist."""

from __future__ import annotations

from collections.abc import Iterable

from sim.tank.faults import FaultKind, FaultValue, InjectedFault, describe_values, parse_fault
from smolbot.config.rig import RigConfig
from smolbot.errors import InputError

MAINS_HZ = 50.0
SPIKE_RATE_HZ = 20.0

LEAST_DRAG = 0.01
"""Least factor of a drag: the model has no inertia, and without drag no speed either."""

_FACTOR = FaultValue("factor", low=0.0)
_DRAG_FACTOR = FaultValue("factor", low=LEAST_DRAG)
_SIGNED_FACTOR = FaultValue("factor")
_HUM = (FaultValue("amplitude", "nT"), FaultValue("frequency", "Hz", MAINS_HZ, low=0.0))

TANK_FAULTS = {
    "sensor_gain": FaultKind("a sensor's gain changes; -1 turns its sign", "sensor", values=(_SIGNED_FACTOR,)),
    "sensor_dead": FaultKind("a sensor reads 0 V", "sensor"),
    "sensor_frozen": FaultKind("a sensor keeps the value that it had", "sensor"),
    "sensor_stuck_bit": FaultKind(
        "a bit of a sensor's converted value is always one", "sensor", values=(FaultValue("bit, 0 the lowest", low=0),)
    ),
    "sensor_offset": FaultKind("a constant is added to a sensor", "sensor", values=(FaultValue("offset", "nT"),)),
    "sensor_drift": FaultKind("a sensor drifts away", "sensor", values=(FaultValue("rate", "nT/s"),)),
    "sensor_hum": FaultKind("a line is added to a sensor", "sensor", values=_HUM),
    "sensor_noise": FaultKind("a sensor's own noise is larger by a factor", "sensor", values=(_FACTOR,)),
    "sensor_spikes": FaultKind(
        "single samples of a sensor jump, up or down", "sensor",
        values=(FaultValue("height", "nT"), FaultValue("rate", "1/s", SPIKE_RATE_HZ, low=0.0)),
    ),
    "sensor_clipped": FaultKind(
        "a sensor reads no more than this, and does not say so", "sensor", values=(FaultValue("limit", "nT"),)
    ),
    "sensors_swapped": FaultKind(
        "two sensors' wires are swapped", "sensor", values=(FaultValue("the other sensor", low=0),)
    ),
    "sensors_saturated": FaultKind("a sensor, or every sensor, reads its upper limit", "sensor", every=True),
    "ambient_hum": FaultKind("a uniform field along (1, 1, 1) is added to what all sensors measure", values=_HUM),
    "windows_lost": FaultKind("listening windows give no recording"),
    "read_timeout": FaultKind("samples do not come in time: listening windows give no recording"),
    "excitation_lost": FaultKind("excitation coils carry no current", "excitation coil", every=True),
    "excitation_gain": FaultKind(
        "excitation coils carry another current, by a factor", "excitation coil", every=True, values=(_SIGNED_FACTOR,)
    ),
    "coil_dead": FaultKind("an actuation coil carries no current", "coil"),
    "coil_gain": FaultKind(
        "actuation coils carry another current, by a factor", "coil", every=True, values=(_SIGNED_FACTOR,)
    ),
    "drag": FaultKind("the drag against translation is another one, by a factor", values=(_DRAG_FACTOR,)),
    "rotation_drag": FaultKind("the drag against rotation is another one, by a factor", values=(_DRAG_FACTOR,)),
    "viscosity": FaultKind("the drag against both is another one, by a factor", values=(_DRAG_FACTOR,)),
    "flow": FaultKind(
        "the liquid flows", values=(FaultValue("speed", "mm/s"), FaultValue("direction from x toward y", "deg", 0.0))
    ),
    "resonance_shift": FaultKind("the device's resonance moves", values=(FaultValue("shift", "Hz"),)),
    "damping": FaultKind("the device's damping is another one, by a factor", values=(_FACTOR,)),
    "moment": FaultKind("the device's moment is another one, by a factor", values=(_FACTOR,)),
}  # fmt: skip
"""Every fault of the tank. Sensors are counted from 0, coils named as in the rig file."""


def describe_fault(name: str) -> tuple[str, str]:
    """Describe a fault for the list of faults.

    Parameters
    ----------
    name : str
        One of `TANK_FAULTS`.

    Returns
    -------
    spelling, about : str

    Examples
    --------
    >>> describe_fault("sensor_hum")
    ('sensor_hum[.SENSOR]=VALUE', 'a line is added to a sensor; amplitude in nT, frequency in Hz (50 unless given)')
    """
    kind = TANK_FAULTS[name]
    channel = f"[.{kind.channel.upper().replace(' ', '_')}]" if kind.channel else ""
    values = describe_values(kind)
    return name + channel + ("=VALUE" if values else ""), kind.about + (f"; {values}" if values else "")


def parse_tank_faults(texts: Iterable[str]) -> tuple[InjectedFault, ...]:
    """Parse the faults of a tank.

    Parameters
    ----------
    texts : iterable of str
        As `sim.tank.faults.parse_fault` takes them.

    Returns
    -------
    tuple of InjectedFault

    Raises
    ------
    InputError
        For the first that cannot be read.

    Examples
    --------
    >>> [fault.name for fault in parse_tank_faults(["sensor_gain.3=0.5@30s", "drag=0.5"])]
    ['sensor_gain', 'drag']
    """
    return tuple(parse_fault(text, TANK_FAULTS) for text in texts)


def find_channels(fault: InjectedFault, rig: RigConfig) -> tuple[int, ...]:
    """Find the channels that a fault concerns.

    Parameters
    ----------
    fault : InjectedFault
    rig : RigConfig

    Returns
    -------
    tuple of int
        Indices of sensors, of actuation coils or of excitation coils; empty for a fault without channels.

    Raises
    ------
    InputError
        If the rig has no such channel, or a sensor is to be swapped with itself.
    """
    kind = TANK_FAULTS[fault.name]
    names = {
        "": (),
        "sensor": tuple(str(i) for i in range(len(rig.sensors))),
        "coil": tuple(coil.name for coil in rig.sections.coils),
        "excitation coil": tuple(coil.name for coil in rig.sections.excitation),
    }[kind.channel]
    if not kind.channel:
        return ()
    if not names:
        raise InputError(f"--fault {fault.text}: '{rig.name}' has no {kind.channel}.")
    if fault.name == "sensors_swapped":
        other = f"{fault.values[0]:g}"
        require_channel(fault, other, names, rig)
        if other == (fault.channel or names[0]):
            raise InputError(f"--fault {fault.text}: sensor {other} cannot be swapped with itself.")
    if not fault.channel:
        return tuple(range(len(names))) if kind.every else (0,)
    require_channel(fault, fault.channel, names, rig)
    return (names.index(fault.channel),)


def require_channel(fault: InjectedFault, channel: str, names: tuple[str, ...], rig: RigConfig) -> None:
    """Raise `InputError` if a fault's channel is none of the rig's.

    Parameters
    ----------
    fault : InjectedFault
    channel : str
    names : tuple of str
        Channels of that kind.
    rig : RigConfig
    """
    if channel not in names:
        what = TANK_FAULTS[fault.name].channel
        raise InputError(f"--fault {fault.text}: '{rig.name}' has no {what} '{channel}'; it has {', '.join(names)}.")
