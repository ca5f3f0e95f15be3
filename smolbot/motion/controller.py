"""The interface of controllers, which turn poses into commands. Controllers never extrapolate poses in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, runtime_checkable

from smolbot.core.arrays import FloatArray
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device
from smolbot.core.shots import Actuate, Excite, Listen, Mechanical, RingDown, Rotate
from smolbot.errors import InputError, suggest_name
from smolbot.motion.helix import Helix
from smolbot.motion.robot import Robot
from smolbot.paths.curve import Curve

if TYPE_CHECKING:
    from lookup_tables import FieldTable


Phase = Literal["approach", "follow"]


@dataclass(frozen=True)
class Gain:
    """A number that a user may tune: its default, its range, and whether the range is logarithmic.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.Gain(150.0, 20.0, 300.0, log=True, meaning="the strongest pull, in µN").default
    150.0
    """

    default: float
    low: float
    high: float
    log: bool = False
    meaning: str = ""


@dataclass(frozen=True)
class Cycle:
    """Localization part of every cycle. SI units.

    Attributes
    ----------
    excite_cycles : int
        Length of the excitation, in periods of the device.
    ring_down : float, in s
    half_periods : int
        Length N of the listening window, in half-periods of the device.
    excite_current : float, in A
        Peak in the coil with the largest current.
    """

    excite_cycles: int = 5
    ring_down: float = 0.020
    half_periods: int = 2
    excite_current: float = 10.0

    def windows(self, frequency: float) -> tuple[Excite, RingDown, Listen]:
        """Make the windows of the localization: excitation by the first coil, ring-down, listening.

        Parameters
        ----------
        frequency : float, in Hz
            Resonance of the device.

        Returns
        -------
        tuple of (Excite, RingDown, Listen)
        """
        drive = Excite((self.excite_current, 0.0), frequency, self.excite_cycles)
        return drive, RingDown(self.ring_down), Listen(self.half_periods, frequency)

    def duration(self, frequency: float) -> float:
        """Compute the time from the end of the actuation to the end of listening.

        Parameters
        ----------
        frequency : float, in Hz
            Resonance of the device.

        Returns
        -------
        float, in s
        """
        return self.excite_cycles / frequency + self.ring_down + self.half_periods / (2.0 * frequency)


@dataclass(frozen=True)
class Setup:
    """Everything that a controller is given: model parameters, never ground truth.

    Attributes
    ----------
    table : FieldTable
        Field of the actuation coils, world frame.
    limits : Limits
    device : Device
    robot : Robot
    cycle : Cycle
    tolerance : float, in m
        Distance within which a goal counts as reached (Eq. S16).

    Examples
    --------
    >>> import smolbot
    >>> setup = smolbot.load_mission("line").setup()
    >>> setup.limits.coils, setup.tolerance
    (('+x', '-x', '+y', '-y'), 0.0008)
    """

    table: FieldTable
    limits: Limits
    device: Device
    robot: Robot
    cycle: Cycle
    tolerance: float = 0.8e-3


@dataclass(frozen=True)
class HelixSetup:
    """Everything that the controller of a helical robot is given: model parameters, never ground truth.

    Attributes
    ----------
    helix : Helix
    limits : Limits
    device : Device
    cycle : Cycle
    move : float, in s
        Expected time to bring the magnet near or to take it away.
    tolerance : float, in m
        Distance within which the path's end counts as reached.
    """

    helix: Helix
    limits: Limits
    device: Device
    cycle: Cycle
    move: float
    tolerance: float = 0.8e-3


@dataclass(frozen=True)
class Command:
    """What to do next.

    Attributes
    ----------
    window : Actuate, Rotate, a tuple of mechanical windows, or None
        Mechanical windows are played as a shot of their own. None: do nothing this cycle but listen.
    saturated : bool
        True if a limit reduced the command.
    note : str
        Remark for the user and the record.
    progress : float, in m
        Arc length of the path that was covered. Optional, but needed to analyse the controller's margins.
    phase : {"approach", "follow"}
        Moving to the path's start, or following the path.
    done : bool
        True once the path's end is reached.
    stuck : bool
        True if the controller cannot continue; the note gives the reason.
    event : str
        Event to record, such as a step-out; empty if there is none.

    Examples
    --------
    >>> import smolbot
    >>> command = smolbot.Command(smolbot.Actuate((6.2, 0.0), 0.030), saturated=True, note="cut short")
    >>> command.window.duration, command.done
    (0.03, False)
    """

    window: Actuate | Rotate | tuple[Mechanical, ...] | None
    saturated: bool = False
    note: str = ""
    progress: float = 0.0
    phase: Phase = "follow"
    done: bool = False
    stuck: bool = False
    event: str = ""

    @property
    def mechanical(self) -> tuple[Mechanical, ...]:
        """Its mechanical windows; empty if it has none."""
        if isinstance(self.window, tuple):
            return self.window
        return (self.window,) if isinstance(self.window, Rotate) else ()


@dataclass(frozen=True)
class ForceProfile:
    """Force of a controller along a path, computed from the field table and the model parameters.

    Attributes
    ----------
    points : ndarray, shape (n, 3), in m, world frame
    force : ndarray, shape (n,), in N
        Magnitude of the force.
    direction_error : ndarray, shape (n,), in rad
        Angle between that force and the path.
    """

    points: FloatArray
    force: FloatArray
    direction_error: FloatArray


class Controller(Protocol):
    """Protocol of controllers. One is made per mission, from a setup and its gains.

    A controller may also implement the protocols below, all of which are optional: `RobotKinds`, `ForceForecast`,
    `BendForecast`, `PlaybackAware`, `MotionAware`.

    Parameters
    ----------
    setup : Setup
    gains : mapping of str to float

    Attributes
    ----------
    gains : mapping of str to Gain
        Numbers that a user may tune, by name; an attribute of the class.

    Examples
    --------
    >>> import smolbot
    >>> class Resting:
    ...     gains = {"patience_s": smolbot.Gain(1.0, 0.1, 10.0)}
    ...     def __init__(self, setup, gains):
    ...         self.setup = setup
    ...     def reset(self, path, pose):
    ...         self.path = path
    ...     def command(self, pose):
    ...         return smolbot.Command(None, note="resting")
    >>> controller: smolbot.Controller = Resting(None, {})
    """

    gains: ClassVar[Mapping[str, Gain]]

    def __init__(self, setup: Setup, gains: Mapping[str, float]) -> None:
        """Make a controller for one mission.

        Parameters
        ----------
        setup : Setup
            A `HelixSetup` for a helical robot.
        gains : mapping of str to float
            Gains that differ from their defaults.
        """

    def reset(self, path: Curve, pose: Pose) -> None:
        """Begin a path from a pose.

        Parameters
        ----------
        path : Curve
        pose : Pose
            Of the robot when the first command begins.
        """

    def command(self, pose: Pose) -> Command:
        """Compute the next command.

        Parameters
        ----------
        pose : Pose
            Of the robot when the command begins.

        Returns
        -------
        Command
        """


@runtime_checkable
class RobotKinds(Protocol):
    """A controller class for robots of other kinds than ``gradient``.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of robot that it steers, as in robot files; an attribute of the class.
    """

    kinds: ClassVar[tuple[str, ...]]


@runtime_checkable
class ForceForecast(Protocol):
    """A controller of a gradient-pulled robot that can compute its force along a path."""

    def reach(self, path: Curve) -> ForceProfile:
        """Compute the controller's force along a path, which `preview` shows.

        Parameters
        ----------
        path : Curve

        Returns
        -------
        ForceProfile
        """


@runtime_checkable
class BendForecast(Protocol):
    """A controller of a helical robot that can compute how tightly the robot turns."""

    def tightest_bend(self) -> float:
        """Compute the radius of the tightest possible bend, which `preview` compares with the path.

        Returns
        -------
        float, in m
        """


@runtime_checkable
class PlaybackAware(Protocol):
    """A controller that learns from the effect of its commands."""

    def unplayed(self) -> None:
        """Discard the last command: it was not played, since the loop was paused or had lost the signal."""


@runtime_checkable
class MotionAware(Protocol):
    """A controller of a gradient-pulled robot that uses what the tracker has learned of the robot's motion."""

    def adopt_motion(self, gains: FloatArray, drift: FloatArray) -> None:
        """Take over what the tracker has learned, before the next command.

        It is called once the tracker no longer trusts the motion model of the files, and then before every command.

        Parameters
        ----------
        gains : ndarray, shape (n_coils,)
            Factors on the coils' currents with which the setup's robot moves as it truly does: all 2 for half the
            drag, one of them 0 for a coil that carries no current.
        drift : ndarray, shape (3,), in m/s
            Steady velocity, world frame, that no current causes, such as that of a liquid that flows.
        """


def robot_kinds(law: type[Controller]) -> tuple[str, ...]:
    """Return the kinds of robot that a controller class steers: ``gradient`` unless it names others.

    Parameters
    ----------
    law : type
        A controller class.

    Returns
    -------
    tuple of str
    """
    return law.kinds if isinstance(law, RobotKinds) else ("gradient",)


def complete_gains(
    known: Mapping[str, Gain], given: Mapping[str, float], law: str, rising: tuple[str, str] | None = None
) -> dict[str, float]:
    """Complete the given gains with the defaults.

    Parameters
    ----------
    known : mapping of str to Gain
    given : mapping of str to float
    law : str
        Name of the controller, for messages.
    rising : tuple of 2 str, optional
        Two gains of which the first must not exceed the second.

    Returns
    -------
    dict of str to float
        A value for every known gain.

    Raises
    ------
    InputError
        For every unknown gain, and every one outside its range; or if the first of the two `rising` gains exceeds
        the second.
    """
    faults = [find_gain_fault(known, name, value, law) for name, value in given.items()]
    found = [fault for fault in faults if fault]
    if found:
        raise InputError(" ".join(found))
    values = {name: float(given.get(name, gain.default)) for name, gain in known.items()}
    if rising is not None and values[rising[0]] > values[rising[1]]:
        low, high = rising
        got = f"got {values[low]:g} and {values[high]:g}."
        raise InputError(f"{low} must not exceed {high} of {law}; {got}")
    return values


def find_gain_fault(known: Mapping[str, Gain], name: str, value: Any, law: str) -> str | None:
    """Explain what is wrong with one gain of a controller.

    Parameters
    ----------
    known : mapping of str to Gain
    name : str
    value : float
    law : str
        Name of the controller, for messages.

    Returns
    -------
    str or None
        None if the gain is valid.
    """
    if name not in known:
        return f"unknown gain of {law}; known gains: {', '.join(known)}.{suggest_name(name, known)}"
    gain = known[name]
    if not gain.low <= value <= gain.high:
        return f"must lie within {gain.low:g} to {gain.high:g}; got {value:g}."
    return None
