"""Search for the serial port of the magnet stage, by its USB identifiers and then by its banner."""

from __future__ import annotations

from smolbot.bench.hardware.stage.link import Link
from smolbot.errors import RigError

BOARDS = frozenset({
    (0x2341, 0x0043), (0x2341, 0x0001), (0x2341, 0x0243), (0x2A03, 0x0043),  # Arduino Uno, R3 and older
    (0x1A86, 0x7523), (0x0403, 0x6001), (0x10C4, 0xEA60),  # converters on boards that are built like it
})  # fmt: skip
"""USB vendor and product ids of boards that may carry the firmware."""


def open_link(port: str, baud: int) -> Link:
    """Open the link to the magnet stage.

    Parameters
    ----------
    port : str
        Empty to search for the only port that answers as a magnet stage.
    baud : int

    Returns
    -------
    Link

    Raises
    ------
    RigError
        If the given port cannot be used, or not exactly one port answers; the message has every port's answer.
    """
    return Link(port, baud) if port else _search_ports(baud)


def _search_ports(baud: int) -> Link:
    from serial.tools import list_ports

    candidates = [p.device for p in list_ports.comports() if (p.vid, p.pid) in BOARDS]
    found: list[Link] = []
    answers: list[str] = []
    for device in candidates:
        try:
            found.append(Link(device, baud))
        except RigError as error:
            answers.append(str(error))
    if len(found) == 1:
        return found[0]
    for link in found:
        link.close()
    if found:
        raise RigError(
            f"magnet stage: {len(found)} ports answer as one: {', '.join(link.port for link in found)}; "
            "name one in bench.stage.port.",
            device="magnet stage",
        )
    if not candidates:
        raise RigError(
            "magnet stage: no Arduino Uno on any USB port; plug it in, or name its port in bench.stage.port.",
            device="magnet stage",
        )
    raise RigError(
        f"magnet stage: none of {len(candidates)} USB ports answers as one. {' '.join(answers)}", device="magnet stage"
    )
