"""Protocols of a lab's own path readers, kinds of sensors and studies: entry points, checked when they are loaded.

A lab's own controller implements `smolbot.motion.controller.Controller`, its own world `smolbot.config.world.World`.
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
        True if such a file may hold several shapes: ``[path] element`` selects one, ``width_mm`` and ``height_mm``
        scale it. If it is false, a mission may give none of the three.
    """

    has_shapes: ClassVar[bool]

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Read the points of a path in the order of travel.

        Parameters
        ----------
        path : Path
            The file that the mission names.
        element : str or None
            Name of the shape to read.
        width_mm, height_mm : float or None, in mm
            Size to which the shape is scaled; one of them alone keeps the aspect ratio.

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
    """Converts one kind of sensors to single-axis sensors; an entry point of ``smolbot.sensors``.

    A rig file selects it by ``[sensors] kind``, and gives the keys of `section` beside it. Localization, simulation
    and checks of the rig use the single-axis sensors only.

    Attributes
    ----------
    section : type of FileModel
        Keys that ``[sensors]`` has for this kind, checked strictly.
    """

    section: ClassVar[type[FileModel]]

    @staticmethod
    def expand(section: Any) -> Mapping[str, Any]:
        """Convert a section to single-axis sensors.

        Parameters
        ----------
        section : FileModel
            ``[sensors]`` of the rig file, an instance of the class attribute `section`.

        Returns
        -------
        mapping
            Keys and values of ``[sensors]`` as for single-axis sensors (`smolbot.config.sensors.SensorsSection`): a
            position in mm, an axis and, where they differ, a gain for each; sensitivity, range, bandwidth, tolerances.

        Raises
        ------
        ValueError
            If the values are inconsistent; the message puts file and line before its text.
        """


class StudyPlugin(Protocol):
    """A study of `smolbot study`; an entry point of ``smolbot.studies`` that names an object, not a class.

    `sim.studies.Study` implements it: a lab builds one from its own functions, and omits fields with a default.

    Attributes
    ----------
    name, title : str
        Its names on the command line and in tables.
    devices : callable
        Returns the devices that it studies, by name.
    estimators : tuple of str
        Those that are used if none is requested.
    mission : bool
        True if it studies the loop of a mission, which is then given on the command line.
    rig_of : callable or None
        Returns the rig that is described beside the results; None for the one of ``--rig``.
    files : callable or None
        Returns the contents of text files to write beside the figure, by file name.
    notes : mapping
        Stored in ``study.json``.
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
            Options of the command line.

        Returns
        -------
        list of sim.studies.Chunk
            Each with a seed of its own, so that the result does not depend on how many run at once.
        """

    def conclude(self, options: Any, parts: list[Any]) -> Any:
        """Combine the results of the pieces.

        Parameters
        ----------
        options : sim.studies.Options
        parts : list of sim.studies.Columns
            Results of the pieces, in their order.

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
