"""What a lab's own path reader, kind of sensors and study promise; each is an entry point, checked when it is loaded.

A lab's own controller keeps `smolbot.motion.controller.Controller`, its own world `smolbot.config.world.World`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol

from smolbot.config.document import FileModel
from smolbot.core.arrays import FloatArray


class PathReader(Protocol):
    """Reads paths from one kind of file; an entry point of ``smolbot.path_readers``, named by the suffix: ``svg``.

    Attributes
    ----------
    has_shapes : bool
        Whether such a file may hold several shapes, of which ``[path] element`` names one, and whether a shape may be
        brought to a size by ``width_mm`` and ``height_mm``. Where it is false, a mission may give none of the three.
    """

    has_shapes: ClassVar[bool]

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Read the points of a path in the order in which they are flown.

        Parameters
        ----------
        path : Path
            The file that the mission names.
        element : str or None
            Name of the shape that is meant.
        width_mm, height_mm : float or None, in mm
            Size that the shape is brought to; with one of them its aspect is kept.

        Returns
        -------
        ndarray, shape (n, 2), in mm
            x and y in the world frame, relative to the mission's ``[path] center_mm``.

        Raises
        ------
        InputError
            With file and line of what cannot be read.
        """


class SensorKind(Protocol):
    """Tells what single-axis sensors a kind of sensors amounts to; an entry point of ``smolbot.sensors``.

    A rig file names it by ``[sensors] kind``, and gives the keys of `section` beside it. All that localizes, simulates
    and checks the rig sees the single-axis sensors alone.

    Attributes
    ----------
    section : type of FileModel
        Keys that ``[sensors]`` has for this kind, checked strictly.
    """

    section: ClassVar[type[FileModel]]

    @staticmethod
    def expand(section: Any) -> Mapping[str, Any]:
        """Tell which single-axis sensors these are.

        Parameters
        ----------
        section : FileModel
            ``[sensors]`` of the rig file, an instance of the class attribute `section`.

        Returns
        -------
        mapping
            Keys and values of ``[sensors]`` as for single-axis sensors (`smolbot.config.sensors.SensorsSection`): a
            place in mm, an axis and, where they differ, a gain for each; sensitivity, range, bandwidth, tolerances.

        Raises
        ------
        ValueError
            If the values do not go together; its text follows file and line.
        """


class StudyPlugin(Protocol):
    """A study of `smolbot study`; an entry point of ``smolbot.studies``, where an object is named, not its class.

    `sim.studies.Study` keeps it: a lab makes one of its own functions, and omits what has a default there.

    Attributes
    ----------
    name, title : str
        What it is called on the command line, and in tables.
    devices : callable
        Returns the devices that it studies, by name.
    estimators : tuple of str
        Those that are used where none is asked for.
    mission : bool
        Whether it is of a mission's loop, which is then given on the command line.
    rig_of : callable or None
        Returns the rig that is described beside the results; None for the one of ``--rig``.
    files : callable or None
        Returns texts that are left beside the figure, by file name.
    notes : mapping
        Kept in ``study.json``.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    devices: ClassVar[Callable[[], Mapping[str, Any]]]
    estimators: ClassVar[tuple[str, ...]]
    mission: ClassVar[bool]
    rig_of: ClassVar[Callable[[Any], Any] | None]
    files: ClassVar[Callable[[Any], Mapping[str, str]] | None]
    notes: ClassVar[Mapping[str, Any]]

    def chunks(self, options: Any) -> list[Any]:
        """Cut the study into pieces that run in any process.

        Parameters
        ----------
        options : sim.studies.Options
            What was asked for on the command line.

        Returns
        -------
        list of sim.studies.Chunk
            Each with a seed of its own, so that the result does not depend on how many run at once.
        """

    def conclude(self, options: Any, parts: list[Any]) -> Any:
        """Sum up.

        Parameters
        ----------
        options : sim.studies.Options
        parts : list of sim.studies.Columns
            What the pieces returned, in their order.

        Returns
        -------
        sim.studies.Outcome
        """

    def draw(self, outcome: Any, path: Path) -> None:
        """Draw the study's figure.

        Parameters
        ----------
        outcome : sim.studies.Outcome
        path : Path
            The PNG file to write.
        """
