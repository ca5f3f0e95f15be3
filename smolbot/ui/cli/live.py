"""``--live``: a mission's link to its console, for as long as it flies."""

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
    """Join a console; yields what `fly` takes as its pause and its live pump.

    Raises
    ------
    InputError
        If there is none, and none can be opened. Nothing has moved by then.
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
