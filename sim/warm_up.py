"""Compiles every kernel and builds the shipped tables ahead of the first flight: ``python -m sim.warm_up``."""

from __future__ import annotations


def warm_up() -> None:
    """Fly the beginning of three missions, and draw them; what that needs is compiled and cached."""
    import tempfile

    import smolbot

    with tempfile.TemporaryDirectory() as folder:
        for mission in ("line", "r_path"):
            out = f"{folder}/{mission}"
            smolbot.run(mission, seed=0, out=out, stop__max_duration_s=2.0, localization__quiet_s=1.0, force="preview")
        out = f"{folder}/s_path"  # one maneuver of the magnet takes half a minute of its time
        smolbot.run("s_path", seed=0, out=out, stop__max_duration_s=30.0, localization__quiet_s=1.0, force="preview")


if __name__ == "__main__":
    warm_up()
