"""Figures of the signals: explained share, fit residuals, and background noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray
from smolbot.runs.pictures.style import COILS, LOCATED, TRUE, draw_dots, draw_empty_note
from smolbot.runs.report.background_spectrum import BackgroundSpectrum, find_background_recordings
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.residuals import BLOCK_DURATION, FittedWindow, compute_density, cut_background
from smolbot.runs.report.svg import FAINT, INK, make_wide_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Places = npt.NDArray[np.intp]

N_CHANNELS_SHOWN = 4
"""Channels of the window that is shown: those with the largest signal."""

MAX_FREQUENCY = 2000.0
"""In Hz: above it the sensors measure little."""


def draw_fit_figure(flight: RecordedFlight, windows: list[FittedWindow], lines: FloatArray) -> Figure:
    """Draw R² over the run, one window with its model, and the spectrum of residuals and of background noise.

    Parameters
    ----------
    flight : RecordedFlight
    windows : list of FittedWindow
    lines : ndarray, shape (n,), in Hz
        Frequencies to mark in the spectrum.

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(6.4)
    panels: Any = figure.subplot_mosaic([["r", "window"], ["spectrum", "spectrum"]], height_ratios=[1.0, 1.1])
    _draw_r_squared(panels["r"], flight)
    _draw_window(panels["window"], windows)
    _draw_spectrum(panels["spectrum"], flight, windows, lines)
    return figure


def draw_noise_figure(noise: BackgroundSpectrum) -> Figure:
    """Draw the spectral density of every channel's background noise, with the learned mains lines.

    Parameters
    ----------
    noise : BackgroundSpectrum

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(3.6)
    axes = figure.subplots()
    shown = noise.frequencies <= MAX_FREQUENCY
    thinned = _choose_edges(noise.frequencies[shown])
    for index, channel in enumerate(noise.density[:, shown]):
        axes.plot(noise.frequencies[shown][thinned], 1e12 * _find_highest(channel, thinned),
                  color=COILS[index % len(COILS)], lw=0.7, alpha=0.75, label=f"{index}")  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    _mark_lines(axes, noise.line_frequencies)
    floor = 1e12 * float(np.median(noise.floor))
    axes.axhline(floor, color="#999999", lw=1, ls="--")
    axes.text(1.0, floor, f"floor {floor:.1f} ", fontsize=8.5, color="#777777", va="top", ha="right",
              transform=axes.get_yaxis_transform())  # fmt: skip
    axes.set_title("Noise of every channel with nothing driven, in pT per root of Hz", pad=16)
    axes.set_xlabel("frequency in Hz")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), title="channel", fontsize=8, title_fontsize=8)
    axes.grid()
    return figure


def _draw_r_squared(axes: Axes, flight: RecordedFlight) -> None:
    poses = [c.pose for c in flight.run.cycles if c.pose is not None]
    good = [p for p in poses if p.trusted]
    if poses:
        axes.set_yscale("log")
        draw_dots(
            axes, [p.time for p in good], [1.0 - p.r_squared for p in good], 2.4, TRUE, alpha=0.7, label="trusted"
        )
        bad = [p for p in poses if not p.trusted]
        if bad:
            shares = [max(1.0 - p.r_squared, 1e-6) for p in bad]
            draw_dots(axes, [p.time for p in bad], shares, 4.0, LOCATED, label="not trusted")
            axes.legend(loc="upper right")
        median = float(np.median([p.r_squared for p in (good or poses)]))
        axes.set_title(f"Unexplained share of the signal, 1 - R²; median R² {median:.4f}")
    else:
        draw_empty_note(axes, "no pose was found")
    axes.set_xlabel("time in s")
    axes.grid(axis="y")


def _draw_window(axes: Axes, windows: list[FittedWindow]) -> None:
    if not windows:
        draw_empty_note(axes, "this record holds no samples")
        return
    chosen = windows[len(windows) // 2]
    loud = np.argsort(-np.sum(np.where(chosen.used[:, None], chosen.measured, 0.0) ** 2, axis=1))[:N_CHANNELS_SHOWN]
    gap = 2.1e9 * float(np.abs(chosen.measured[loud]).max())
    ms = 1e3 * chosen.seconds
    for row, channel in enumerate(loud):
        low = -row * gap
        axes.plot(ms, low + 1e9 * chosen.model[channel], color=TRUE, lw=1.6, label="model" if row == 0 else None)
        draw_dots(
            axes,
            ms,
            low + 1e9 * chosen.measured[channel],
            2.0,
            LOCATED,
            label="measured" if row == 0 else None,
            zorder=3,
        )
        place = axes.get_yaxis_transform()
        axes.text(1.01, low, f"ch. {channel}", transform=place, fontsize=8.5, color=FAINT, va="center")
    axes.set_title(f"One window, at {chosen.time:.1f} s: its {len(loud)} strongest channels, in nT")
    axes.set_xlabel("time since the first sample, in ms")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, -0.01), ncol=2, fontsize=8.5)
    axes.set_ylim(-(len(loud) - 0.4) * gap, 0.62 * gap)


def _draw_spectrum(axes: Axes, flight: RecordedFlight, windows: list[FittedWindow], lines: FloatArray) -> None:
    if not windows:
        draw_empty_note(axes, "this record holds no samples")
        return
    rate, n = 1.0 / BLOCK_DURATION, min(window.residuals.shape[1] for window in windows)
    background = cut_background(find_background_recordings(flight), n, 0)
    grid, residuals = compute_density([window.residuals for window in windows], rate)
    _, signal = compute_density([window.measured[window.used] for window in windows], rate)
    shown = (grid > 0) & (grid <= MAX_FREQUENCY)
    axes.set_yscale("log")
    axes.plot(grid[shown], 1e12 * signal[shown], color=FAINT, lw=1.2, label="measured")
    if background:
        axes.plot(grid[shown], 1e12 * compute_density(background, rate)[1][shown], color=TRUE, lw=3.5, alpha=0.55,
                  label="background windows of the same length")  # fmt: skip
    axes.plot(grid[shown], 1e12 * residuals[shown], color=LOCATED, lw=1.4, label="fit residuals")
    _mark_lines(axes, lines)
    axes.set_title(
        f"Spectrum of the fit residuals, mean over {len(windows)} windows and all channels, in pT per root of Hz",
        pad=16,
    )
    axes.set_xlabel(f"frequency in Hz (resolution {grid[1]:.0f} Hz)")
    axes.set_xlim(0.0, 6.0 * max(flight.mission.robot.device.frequency, 100.0))
    axes.legend(loc="upper right")
    axes.grid()


def _mark_lines(axes: Axes, lines: FloatArray) -> None:
    for line in lines:
        axes.axvline(float(line), color=FAINT, lw=0.8, ls=":", zorder=1)
        axes.annotate(f"{line:.0f} Hz", (float(line), 1.0), xycoords=axes.get_xaxis_transform(), xytext=(0, 2),
                      textcoords="offset points", ha="center", fontsize=8, color=INK)  # fmt: skip


def _choose_edges(frequencies: FloatArray) -> Places:
    """Choose where each stretch of a spectrum begins; none is narrower than a line on a logarithmic axis."""
    edges = np.unique(np.searchsorted(frequencies, np.geomspace(frequencies[0], frequencies[-1], 420)))
    return edges[edges < len(frequencies)]


def _find_highest(values: FloatArray, edges: Places) -> FloatArray:
    """Return the highest value of each stretch, so that no mains line is lost."""
    found: FloatArray = np.maximum.reduceat(values, edges)
    return found
