"""Draws the figures of the concept pages with the project's own code: `make figures`.

    python docs/figures.py [NAME ...]

Each figure is a function of that name; it is written to docs/pictures.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = Path(__file__).parent / "pictures"
DARK, RED, ORANGE, PALE, GREY = "#1d4363", "#e0582b", "#f0a03c", "#8fb0c9", "#b9bec8"
FREQUENCY = 103.5


def axes(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Make a figure in the project's style.

    Parameters
    ----------
    rows, columns : int
    size : tuple of float, in inches
    **options
        Passed to ``matplotlib.pyplot.subplots``.

    Returns
    -------
    tuple
        The figure, and its axes.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.titlelocation": "left",
         "axes.titlesize": 10.5, "legend.frameon": False, "savefig.dpi": 150}
    )  # fmt: skip
    return plt.subplots(rows, columns, figsize=size, layout="constrained", **options)


def save(figure: Any, name: str, *, shaded: bool = False) -> None:
    """Write a figure as PNG, with few colours unless it is shaded.

    Parameters
    ----------
    figure : matplotlib Figure
    name : str
        Of the file, without suffix.
    shaded : bool
        Whether to keep all colours.
    """
    from PIL import Image

    path = PICTURES / f"{name}.png"
    figure.savefig(path)
    if shaded:
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")
        return
    with Image.open(path) as image:
        few = image.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


def tank(start: tuple[float, float] = (0.0, 0.0), seed: int = 1, *, ideal: bool = True) -> Any:
    """Open the shipped tank.

    Parameters
    ----------
    start : tuple of float, in m
        Start position (x, y) of the robot.
    seed : int
    ideal : bool
        Whether to leave out noise and mismatch.

    Returns
    -------
    Rig
    """
    from sim import TankWorld
    from smolbot import load_rig, load_robot

    return TankWorld.open(load_rig("tank"), load_robot("gradient"), start, seed, ideal=ideal)


def cycle() -> None:
    """Draw one shot: outputs, and the recording."""
    from smolbot import Actuate, Excite, Listen, RingDown, Shot

    pull, drive = Actuate((8.0, 0.0, 3.0, 0.0), 0.060), Excite((2.2, 2.2), FREQUENCY, 3)
    windows = (pull, drive, RingDown(0.020), Listen(2, FREQUENCY))
    with tank((0.002, 0.003)) as rig:
        recording = rig.play(Shot(windows))
    figure, (above, below) = axes(2, 1, (8.2, 4.4), height_ratios=[3, 2])
    ends = np.cumsum([0.0, pull.duration, drive.cycles / FREQUENCY, 0.020, 1.0 / FREQUENCY]) * 1e3
    burst = np.linspace(ends[1], ends[2], 300)
    for name, current, colour in (("+x", 8.0, DARK), ("+y", 3.0, PALE)):
        above.plot([0, 0, ends[1], ends[1], ends[4]], [0, current, current, 0, 0], color=colour, lw=1.8)
        above.annotate(f"{name}", (1.5, current + 0.25), color=colour)
    above.plot(burst, 2.2 * np.sin(2e-3 * np.pi * FREQUENCY * (burst - ends[1])), color=RED, lw=1.4)
    above.annotate("excitation coils x and y", ((ends[1] + ends[2]) / 2, -3.6), color=RED, ha="center")
    above.set(ylabel="current in A", ylim=(-4.4, 11.5), xlim=(0, ends[4]), xticklabels=[])
    for i, name in enumerate(("actuate", "excite", "ring-down", "listen")):
        above.axvline(ends[i + 1], color=GREY, lw=0.8)
        above.text((ends[i] + ends[i + 1]) / 2, 10.2, name, ha="center", color="#444444")
    above.set_title("One shot: what is played …")
    time = ends[3] + 1e3 * np.arange(recording.field.shape[1]) / recording.sample_rate
    swing = (recording.field - recording.field.mean(axis=1, keepdims=True)) * 1e9
    for sensor in range(len(swing)):
        below.plot(time, swing[sensor], color=DARK, lw=0.9, alpha=0.35 + 0.06 * sensor)
    below.set(xlim=(ends[3], ends[4]), xlabel="time in ms", ylabel="field in nT")
    below.set_title("… and what the ten sensors hear, their constants taken off")
    save(figure, "cycle")


def chain() -> None:
    """What the paper's chain makes of a recording, and what whitening does."""
    from smolbot import Excite, Listen, RingDown, Shot
    from smolbot.localization.chain import apply_filters, make_difference_matrix

    with tank((0.002, 0.003)) as rig:
        recording = rig.play(Shot((Excite((2.2, 2.2), FREQUENCY, 3), RingDown(0.020), Listen(6, FREQUENCY))))
    time = 1e3 * np.arange(recording.field.shape[1]) / recording.sample_rate
    difference = make_difference_matrix(rig.sensors.axes, rig.sensors.positions) @ recording.field
    slope = apply_filters(difference, recording.sample_rate)
    figure, panels = axes(1, 3, (9.4, 2.9))
    shown = (
        (recording.field - recording.field.mean(axis=1, keepdims=True), 1e9, "raw, in nT"),
        (difference - difference.mean(axis=1, keepdims=True), 1e9, "same-axis difference, in nT"),
        (slope, 1e6, "smoothed, differentiated, in µT/s"),
    )
    for panel, (signal, scale, title) in zip(panels, shown, strict=True):
        panel.plot(time, scale * signal.T, color=DARK, lw=0.8, alpha=0.6)
        panel.set_title(title)
        panel.set(xlabel="time in ms", xlim=(0, time[-1]))
    points = np.linspace(0, len(time) - 1, 25).astype(int)
    panels[2].plot(time[points], 1e6 * slope[:, points].T, ".", color=RED, ms=3)
    save(figure, "chain")


def noise() -> None:
    """Draw spectra of background noise in one sensor and after the difference, and its correlation."""
    from scipy.signal import welch

    from smolbot import Listen, Shot
    from smolbot.localization.chain import make_difference_matrix

    with tank() as rig:
        background = [rig.play(Shot((Listen(207, FREQUENCY),))) for _ in range(20)]
    rate = background[0].sample_rate
    field = np.stack([recording.field for recording in background])
    field = field - field.mean(axis=2, keepdims=True)
    difference = np.einsum("ds,qsn->qdn", make_difference_matrix(rig.sensors.axes, rig.sensors.positions), field)
    figure, (left, right) = axes(1, 2, (9.4, 3.4), width_ratios=[3, 2])
    for signal, colour, name in ((field, DARK, "one sensor"), (difference, ORANGE, "same-axis difference")):
        frequency, power = welch(signal[:, 0], rate, nperseg=int(0.5 * rate), axis=-1)
        inside = (frequency > 2) & (frequency < 400)
        left.semilogy(frequency[inside], 1e12 * np.sqrt(power.mean(axis=0))[inside], color=colour, lw=1.1, label=name)
    left.axvline(FREQUENCY, color=RED, lw=1.0)
    left.annotate("the device\n103.5 Hz", (FREQUENCY + 4, 800), color=RED)
    left.set(xlabel="frequency in Hz", ylabel="pT/√Hz", xlim=(0, 400))
    left.set_title("A quiet room: mains, drift and sensor noise")
    left.legend(loc="upper right")
    spread = np.corrcoef(field[:, :, :: int(rate / 2000)].swapaxes(0, 1).reshape(field.shape[1], -1))
    image = right.imshow(spread, vmin=-1, vmax=1, cmap="RdBu_r")
    right.set(xlabel="sensor", ylabel="sensor", xticks=range(10), yticks=range(10))
    right.set_title("Noise of the sensors hangs together")
    figure.colorbar(image, ax=right, shrink=0.8, label="correlation")
    save(figure, "noise", shaded=True)


def force() -> None:
    """Draw the force of the paper's law over the workspace, and the strongest force in each direction."""
    from controllers import ForceAllocator
    from controllers.current_ratio import compute_aligned_force, find_best_pair
    from smolbot import load_mission

    setup = load_mission("r_path").setup()
    grid = np.linspace(-18e-3, 18e-3, 25)
    way = np.array([1.0, 0.0])
    off = np.full((len(grid), len(grid)), np.nan)
    arrows = []
    for i, y in enumerate(grid):
        for j, x in enumerate(grid):
            here = np.array([x, y, 0.060])
            fields = setup.table.field(here[None])[:, 0, :2]
            pair = find_best_pair(fields, way)
            if pair is None:
                continue
            currents = np.zeros(len(fields))
            currents[pair.j], currents[pair.k] = 8 * pair.share_j, 8 * pair.share_k
            pull = compute_aligned_force(setup.table, currents, here, setup.robot.moment)[:2]
            off[i, j] = np.degrees(np.arccos(np.clip(pull @ way / np.linalg.norm(pull), -1, 1)))
            if i % 3 == 0 and j % 3 == 0:
                arrows.append((x, y, *(pull / np.linalg.norm(pull))))
    figure, (left, right) = axes(1, 2, (9.4, 3.9), subplot_kw={"aspect": "equal"})
    extent = (1e3 * grid[0], 1e3 * grid[-1]) * 2
    shade = left.imshow(off, origin="lower", extent=extent, cmap="viridis_r", vmin=0, vmax=180)
    at = np.array(arrows)
    left.quiver(1e3 * at[:, 0], 1e3 * at[:, 1], at[:, 2], at[:, 3], color="white", scale=16, width=0.006)
    figure.colorbar(shade, ax=left, shrink=0.85, label="force off the wanted direction, in °")
    left.set_title("Field along +x (the paper's law): where the force points")
    left.set(xlabel="x in mm", ylabel="y in mm")
    allocator = ForceAllocator(setup.table, 8.0, setup.robot.moment, least_field=1.5e-3)
    for x, y, colour in ((0, 0, DARK), (8, 0, RED), (8, 8, ORANGE), (14, 4, "#5a8f29")):
        shape = allocator.reach(np.array([1e-3 * x, 1e-3 * y, 0.060]), 180).polygon * 1e6
        right.plot(*np.vstack([shape, shape[:1]]).T, color=colour, lw=1.5, label=f"({x}, {y}) mm")
    right.plot(0, 0, "+", color="black")
    right.set(xlabel="force along x in µN", ylabel="along y in µN")
    right.set_title("Allocated: the strongest force in each direction")
    right.legend(loc="upper right", fontsize=8, title="robot at")
    save(figure, "force", shaded=True)


def learned() -> None:
    """Draw the error of the tracked position along a flight, with sensors as in the rig file and learned in flight."""
    off = {
        f"rig.sensors.{name}": "0.0" for name in ("place_tolerance_mm", "gain_tolerance_percent", "axis_tolerance_deg")
    }
    figure, panel = axes(1, 1, (8.2, 3.0))
    grid = np.arange(11.0, 58.0, 1.0)
    for settings, colour, name in ((off, ORANGE, "sensors as in the rig file"), ({}, DARK, "learned in flight")):
        curves = np.array([np.interp(grid, *_track_error(seed, settings)) for seed in (1, 2, 3, 4)])
        panel.fill_between(grid, curves.min(axis=0), curves.max(axis=0), color=colour, alpha=0.2, lw=0)
        panel.plot(grid, curves.mean(axis=0), color=colour, lw=2, label=name)
    panel.set(xlabel="time in s", ylabel="believed position off, in mm", ylim=(0, None), xlim=(11, 57))
    panel.set_title("r_path, seeds 1 to 4, means over two seconds: mean, least and most of four flights")
    panel.legend()
    save(figure, "learned")


def _track_error(seed: int, settings: dict[str, str]) -> tuple[Any, Any]:
    """Times in s of a flight, and the error in mm of the tracked position, smoothed over two seconds."""
    from smolbot import load_mission
    from smolbot.flight import fly

    mission = load_mission("r_path", None, settings)
    held: list[Any] = []

    def open_tank(flown: Any, sampled: int) -> Any:
        held.append(tank(tuple(flown.start_placement[:2]), sampled, ideal=False))
        return held[0]

    run = fly(mission, seed, opener=open_tank)
    tracked = [cycle.tracked for cycle in run.cycles if cycle.tracked is not None]
    times = np.array([pose.time for pose in tracked])
    errors = [1e3 * np.linalg.norm(pose.position - held[0].witness.truth(pose.time).position) for pose in tracked]
    return times, np.convolve(errors, np.ones(14) / 14, mode="same")


def mismatch() -> None:
    """Draw the error against the scale of the tank's mismatches."""
    import smolbot

    figure, panel = axes(1, 1, (6.4, 3.2))
    scales = (0.0, 0.5, 1.0, 2.0)
    located, tracked = [], []
    for scale in scales:
        runs = [smolbot.run("r_path", seed=seed, rig__tank__mismatch__scale=scale) for seed in (1, 2, 3, 4)]
        located.append([run.summary["localization_error_mm"]["mean"] for run in runs])
        tracked.append([run.summary["tracking_error_mm"]["rms"] for run in runs])
    for values, colour, name in (
        (located, RED, "localization error, mean"),
        (tracked, DARK, "true robot to path, rms"),
    ):
        panel.plot(scales, np.mean(values, axis=1), "o-", color=colour, label=name)
        panel.plot(np.repeat(scales, 4), np.ravel(values), ".", color=colour, alpha=0.4)
    panel.set(xlabel="scale of all mismatches", ylabel="mm", ylim=(0, None), xticks=scales)
    panel.set_title("r_path, seeds 1 to 4")
    panel.legend()
    save(figure, "mismatch")


def boxes(panel: Any, places: dict[str, tuple[float, float, float, str]]) -> None:
    """Draw named boxes.

    Parameters
    ----------
    panel : matplotlib Axes
    places : dict
        For each name x and y of the middle, width, and colour.
    """
    from matplotlib.patches import FancyBboxPatch

    for text, (x, y, width, colour) in places.items():
        panel.add_patch(
            FancyBboxPatch((x - width / 2, y - 0.32), width, 0.64, boxstyle="round,pad=0.04", fc=colour, ec="none")
        )
        panel.text(x, y, text, ha="center", va="center", color="white", fontsize=10)


def arrow(panel: Any, start: tuple[float, float], end: tuple[float, float], text: str = "", side: float = 0.14) -> None:
    """Draw an arrow with a word beside it.

    Parameters
    ----------
    panel : matplotlib Axes
    start, end : tuple of float
    text : str
    side : float
        Distance of the word above the middle of the arrow.
    """
    panel.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": "#666666", "lw": 1.3})
    panel.text((start[0] + end[0]) / 2, (start[1] + end[1]) / 2 + side, text, ha="center", fontsize=9, color="#444444")


def loop() -> None:
    """Draw the loop: which part passes what to which."""
    figure, panel = axes(1, 1, (8.4, 3.0))
    places = {
        "controller": (0.8, 1.6, 1.5, DARK), "scheduler": (3.2, 1.6, 1.5, DARK), "rig": (5.8, 1.6, 1.2, RED),
        "tracker": (0.8, 0.2, 1.5, DARK), "localizer": (3.2, 0.2, 1.5, DARK), "witness": (8.0, 1.6, 1.2, GREY),
        "record": (8.0, 0.2, 1.2, GREY),
    }  # fmt: skip
    boxes(panel, places)
    arrow(panel, (1.6, 1.6), (2.4, 1.6), "command")
    arrow(panel, (4.0, 1.6), (5.15, 1.6), "shot")
    arrow(panel, (5.5, 1.25), (4.0, 0.3), "")
    panel.text(5.0, 0.55, "recording", fontsize=9, color="#444444")
    arrow(panel, (2.4, 0.2), (1.6, 0.2), "pose")
    arrow(panel, (0.8, 0.56), (0.8, 1.24), "")
    panel.text(0.9, 0.85, "pose when the\nnext shot begins", fontsize=8.5, color="#444444", va="center")
    arrow(panel, (6.45, 1.6), (7.35, 1.6), "truth")
    arrow(panel, (8.0, 1.24), (8.0, 0.56), "")
    panel.axvline(4.55, 0.04, 0.96, color=GREY, ls=(0, (4, 3)), lw=1)
    panel.text(4.45, 2.15, "thinking", ha="right", fontsize=9.5, color="#666666")
    panel.text(4.65, 2.15, "the world: tank, twin or bench", ha="left", fontsize=9.5, color="#666666")
    panel.set(xlim=(-0.1, 8.8), ylim=(-0.25, 2.4))
    panel.axis("off")
    save(figure, "loop")


def bench() -> None:
    """Draw the bench and its twin: the same calls go to other addresses."""
    figure, panel = axes(1, 1, (8.4, 3.4))
    places = {
        "smolbot": (0.9, 1.5, 1.4, DARK), "NI client library": (3.1, 2.4, 1.9, DARK),
        "SCPI over a socket": (3.1, 1.5, 1.9, DARK), "serial line": (3.1, 0.6, 1.9, DARK),
        "PCIe-6363,\nrelays, coils": (5.9, 2.55, 1.7, RED), "power supply": (5.9, 1.6, 1.7, RED),
        "magnet stage": (5.9, 0.65, 1.7, RED), "device server,\ncard model": (8.1, 2.55, 1.8, ORANGE),
        "supply model": (8.1, 1.6, 1.8, ORANGE), "firmware in an\nAVR simulator": (8.1, 0.65, 1.8, ORANGE),
        "tank": (10.2, 1.6, 1.1, GREY),
    }  # fmt: skip
    boxes(panel, places)
    for y in (2.4, 1.5, 0.6):
        arrow(panel, (1.65, 1.5), (2.1, y))
        arrow(panel, (4.1, y), (4.95, y + 0.1))
    for y in (2.55, 1.6, 0.65):
        arrow(panel, (9.05, y), (9.6, 1.6))
    panel.text(5.9, 3.1, "bench", ha="center", color=RED)
    panel.text(8.1, 3.1, "twin", ha="center", color=ORANGE)
    panel.text(7.0, 0.05, "either, by addresses in the rig file", ha="center", fontsize=9, color="#666666")
    panel.set(xlim=(0.1, 10.9), ylim=(-0.1, 3.3))
    panel.axis("off")
    save(figure, "bench")


FIGURES: dict[str, Callable[[], None]] = {
    draw.__name__: draw for draw in (loop, cycle, chain, noise, force, learned, mismatch, bench)
}

if __name__ == "__main__":
    for name in sys.argv[1:] or FIGURES:
        if name not in FIGURES:
            sys.exit(f"no figure is named {name}; there are {', '.join(FIGURES)}.")
        FIGURES[name]()
