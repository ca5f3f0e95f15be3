"""``--live``: the link of a mission to its console during the flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from smolbot.config.load import AnyMission
from smolbot.flight.pause import Pause
from smolbot.flight.safety.stop_latch import Latch
from smolbot.ui.link.join import ConsoleSink, find_console, join_console

if TYPE_CHECKING:
    from smolbot.runs.recording.converter import Converter
    from smolbot.runs.recording.message_queue import MessageQueue


@contextmanager
def connect_console(
    mission: AnyMission, seed: int, latch: Latch, report: Callable[[str], object]
) -> Iterator[tuple[Pause, Callable[[Converter], MessageQueue]]]:
    """Connect a mission to a console while a ``with`` block runs.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
    latch : Latch
        Tripped by a stop from the console.
    report : callable
        Called with the console's address, in a sentence.

    Yields
    ------
    pause : Pause
        For `fly`: held and released from the console.
    live : callable
        For `fly`: makes the recorder sink of the console.

    Raises
    ------
    InputError
        If there is no console, and none can be opened. Nothing has moved by then.
    """
    console, opened = find_console()
    pause = Pause()
    feed = join_console(console, {"mission": f"{mission.name} on {mission.rig.name}", "seed": seed}, latch, pause)
    report(f"live at {console.address}" + ("; that console ends once its page is closed" if opened else ""))

    def pump(converter: Converter) -> MessageQueue:
        from smolbot.runs.recording.message_queue import MessageQueue

        return MessageQueue(ConsoleSink(feed), converter, windows=False)

    try:
        yield pause, pump
    finally:
        feed.end()
