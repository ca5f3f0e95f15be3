"""``--live``: the link of a mission to its console during the flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from smolbot.config.load import AnyMission
from smolbot.flight.pause import Pause
from smolbot.flight.safety.stop_latch import Latch
from smolbot.ui.link.joining import Sent, find_console, join

if TYPE_CHECKING:
    from smolbot.runs.recording.converter import Converter
    from smolbot.runs.recording.pump import Pump


@contextmanager
def watched(
    mission: AnyMission, seed: int, latch: Latch, say: Callable[[str], object]
) -> Iterator[tuple[Pause, Callable[[Converter], Pump]]]:
    """Connect a mission to a console while a ``with`` block runs.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
    latch : Latch
        Tripped by a stop from the console.
    say : callable
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
    feed = join(console, {"mission": f"{mission.name} on {mission.rig.name}", "seed": seed}, latch, pause)
    say(f"live at {console.address}" + ("; that console ends once its page is closed" if opened else ""))

    def pump(converter: Converter) -> Pump:
        from smolbot.runs.recording.pump import Pump

        return Pump(Sent(feed), converter, windows=False)

    try:
        yield pause, pump
    finally:
        feed.end()
