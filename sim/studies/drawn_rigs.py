"""Rigs, robots and missions drawn at random, of which about half cannot work: files as a lab would write them.

Every value is drawn by itself from a range that labs could have: coils of one bench with the sensors of another and the
robot of a third. So preview is asked about worlds that nobody has tuned anything for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray

COIL_COUNTS, COIL_SHARES = (2, 3, 4, 5, 6), (0.1, 0.15, 0.35, 0.15, 0.25)
MAX_CURRENT_A, RESISTANCE_OHM, TURNS = (1.5, 90.0), (0.3, 3.0), (100.0, 400.0)
FACE_MM = (34.0, 60.0)
"""Distance of a coil's face from the middle: the container's corners are 31 mm from it."""

COIL_LENGTH_MM, INNER_SHARE, ANGLE_JITTER_DEG = 20.0, 0.45, 8.0
MAX_OUTER_MM, COIL_GAP = 35.0, 0.85
"""Largest outer radius, and share of the radius at which neighbouring coils would touch."""

SENSOR_COUNTS = (8, 9, 10, 11, 12, 13, 14)
HALF_PLATE_MM, SENSOR_GAP_MM = 75.0, 10.0
SENSOR_AXES, AXIS_SHARES = ("x", "y", "z"), (0.2, 0.2, 0.6)
BANDWIDTH_HZ, SAMPLE_RATES_HZ, RANGE_UT = (80.0, 3000.0), (25_000.0, 50_000.0), (5.0, 100.0)
SURFACE_MM, DEPTH_MM = (52.0, 80.0), 15.0
VISCOSITY_PA_S, TURNAROUND_MS = (0.4, 2.5), (1.0, 20.0)

MOMENT_MA_M2, DRAG_RADIUS_MM, SIZE_FACTOR = (0.4, 1.6), (1.0, 3.0), (0.7, 1.3)
FREQUENCY_HZ, DAMPING_PER_S, THETA_MAX_DEG = (70.0, 220.0), (1.0, 60.0), (8.0, 30.0)
STRONG_DAMPING_PER_S = 5.0
"""Damping above which the envelope is exponential: a linear one would end before the listening window does."""

ACROSS_SHARE, UNIPOLAR_SHARE = 0.15, 0.6
"""Share of devices with the moment across the cantilever, and of supplies that cannot reverse."""

LAWS, LAW_SHARES = ("predictive", "force_pursuit", "current_ratio"), (0.5, 0.25, 0.25)
GLYPHS = ("R", "S", "O", "L", "Z", "8", "C", "V")
GLYPH_WIDTH_MM, GLYPH_ASPECT, DRAWN_SHARE = (3.0, 17.0), (1.0, 1.6), 0.3
"""Width and height over width of letters, and share of paths that are drawn curves of a CSV file instead."""

MAX_HEIGHT_MM = 26.0
MAX_DURATION_S, HALF_PERIODS = (40.0, 300.0), (2, 2, 2, 6, 20)
START_OFFSET_MM = 2.0

FILES = ("mission.toml", "rig.toml", "robot.toml", "robot.urdf", "path.csv")

_BODY_MM, _CENTER_MM, _MASS_MG = (3.0, 2.0, 3.9), 0.5, 20.0  # of the shipped gradient robot


def write_drawn_world(folder: Path, study_seed: int, number: int) -> dict[str, Any]:
    """Draw one world and write its mission, rig and robot file.

    Parameters
    ----------
    folder : Path
        Where to write; it must exist.
    study_seed : int
        Of the study: each has worlds of its own.
    number : int
        Of the world within the study.

    Returns
    -------
    dict
        What was drawn, for the study's table. Units are in the keys.
    """
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([study_seed, number])))
    rig, of_rig = _draw_rig(rng)
    robot, urdf, of_robot = _draw_robot(rng)
    mission, points, of_mission = _draw_mission(rng)
    for name, text in zip(FILES, (mission, rig, robot, urdf, points), strict=True):
        if text:
            (folder / name).write_text(text, encoding="utf-8")
    return {**of_rig, **of_robot, **of_mission}


def _draw_log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Draw a value whose logarithm is uniform."""
    return float(np.exp(rng.uniform(*np.log(span))))


def _draw_rig(rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    count = int(rng.choice(COIL_COUNTS, p=COIL_SHARES))
    unipolar = bool(rng.random() < UNIPOLAR_SHARE)
    current, ohm, turns = _draw_log(rng, MAX_CURRENT_A), _draw_log(rng, RESISTANCE_OHM), rng.uniform(*TURNS)
    face, surface = rng.uniform(*FACE_MM), rng.uniform(*SURFACE_MM)
    outer = MAX_OUTER_MM if count == 2 else min(MAX_OUTER_MM, COIL_GAP * face * math.tan(math.pi / count))
    jitter = np.radians(ANGLE_JITTER_DEG) * rng.uniform(-1.0, 1.0, count)
    angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(count) / count + jitter
    bandwidth, rate = _draw_log(rng, BANDWIDTH_HZ), float(rng.choice(SAMPLE_RATES_HZ))
    places, axes = _draw_sensors(rng, int(rng.choice(SENSOR_COUNTS)))
    height = round(surface, 1)
    coils = [
        {
            "name": f"c{i}",
            "center_mm": [*_rounded((face + 0.5 * COIL_LENGTH_MM) * np.array([np.cos(a), np.sin(a)])), height],
            "axis": _rounded([np.cos(a), np.sin(a), 0.0], 5),
            "inner_radius_mm": round(INNER_SHARE * outer, 1),
            "outer_radius_mm": round(outer, 1),
            "length_mm": COIL_LENGTH_MM,
            "turns": round(turns),
            "time_constant_ms": 3.0,
            "resistance_ohm": round(ohm, 2),
        }
        for i, a in enumerate(angles)
    ]
    sections: dict[str, dict[str, Any]] = {
        "": {
            "extends": "tank",
            "name": "drawn",
            "description": "A rig that was drawn at random",
            "turnaround_ms": round(_draw_log(rng, TURNAROUND_MS), 1),
        },
        "sensors": {
            "positions_mm": places,
            "axes": axes,
            "sample_rate_hz": rate,
            "bandwidth_hz": round(bandwidth, 1),
            "range_ut": round(_draw_log(rng, RANGE_UT), 1),
        },
        "table": {"z_mm": [height - 3.0, height + 3.0], "mesh_mm": 1.0},
        "container": {"floor_z_mm": height - DEPTH_MM, "surface_z_mm": height},
        "medium": {"viscosity_pa_s": round(_draw_log(rng, VISCOSITY_PA_S), 2)},
        "limits": {"max_current_a": round(current, 2), "unipolar": unipolar},
    }
    text = _format_toml(sections) + "".join(_format_toml({"[coils]": coil}) for coil in coils)
    return text, {
        "coils": count,
        "unipolar": unipolar,
        "max_current_a": round(current, 2),
        "face_mm": round(face, 1),
        "surface_mm": height,
        "sensors": len(places),
        "bandwidth_hz": round(bandwidth, 1),
    }


def _draw_sensors(rng: np.random.Generator, count: int) -> tuple[list[list[float]], list[str]]:
    """Draw places, in mm, at least `SENSOR_GAP_MM` apart, and axes."""
    places: list[list[float]] = []
    while len(places) < count:
        place = _rounded(rng.uniform(-HALF_PLATE_MM, HALF_PLATE_MM, 2))
        if all(math.dist(place, other[:2]) >= SENSOR_GAP_MM for other in places):
            places.append([*place, 0.0])
    return places, [str(a) for a in rng.choice(SENSOR_AXES, count, p=AXIS_SHARES)]


def _draw_robot(rng: np.random.Generator) -> tuple[str, str, dict[str, Any]]:
    factor, across = rng.uniform(*SIZE_FACTOR), bool(rng.random() < ACROSS_SHARE)
    moment, radius = _draw_log(rng, MOMENT_MA_M2), _draw_log(rng, DRAG_RADIUS_MM)
    frequency, damping = _draw_log(rng, FREQUENCY_HZ), _draw_log(rng, DAMPING_PER_S)
    size = _rounded(factor * np.array(_BODY_MM))
    sections: dict[str, dict[str, Any]] = {
        "": {"extends": "gradient", "name": "drawn"},
        "body": {
            "size_mm": size,
            "center_mm": [0.0, 0.0, round(factor * _CENTER_MM, 2)],
            "mass_mg": round(_MASS_MG * factor**3, 2),
            "drag_radius_mm": round(radius, 2),
            "urdf": "robot.urdf",
        },
        "device": {
            "moment_ma_m2": round(moment, 3),
            "moment_in_body": [1, 0, 0] if across else [0, 0, 1],
            "theta_max_deg": round(rng.uniform(*THETA_MAX_DEG), 1),
            "frequency_hz": round(frequency, 1),
            "damping_per_s": round(damping, 1),
            "damping_model": "exponential" if damping > STRONG_DAMPING_PER_S else "linear",
        },
    }
    drawn = {
        "moment_ma_m2": round(moment, 3),
        "drag_radius_mm": round(radius, 2),
        "frequency_hz": round(frequency, 1),
        "damping_per_s": round(damping, 1),
        "across": across,
    }
    return _format_toml(sections), _format_urdf(size, _MASS_MG * factor**3), drawn


def _draw_mission(rng: np.random.Generator) -> tuple[str, str, dict[str, Any]]:
    law = str(rng.choice(LAWS, p=LAW_SHARES))
    width, aspect = rng.uniform(*GLYPH_WIDTH_MM), rng.uniform(*GLYPH_ASPECT)
    height = min(width * aspect, MAX_HEIGHT_MM)
    kind, glyph = str(rng.choice(tuple(_CURVES))), str(rng.choice(GLYPHS))
    points = ""
    if rng.random() < DRAWN_SHARE:
        curve = 0.5 * np.array([width, height]) * _CURVES[kind]
        points = "x_mm,y_mm\n" + "".join(f"{x:.4f},{y:.4f}\n" for x, y in curve)
        path: dict[str, Any] = {"file": "path.csv"}
    else:
        path, kind = {"glyph": glyph, "width_mm": round(width, 1), "height_mm": round(height, 1)}, glyph
    limit = round(_draw_log(rng, MAX_DURATION_S))
    offset = _rounded(rng.uniform(-START_OFFSET_MM, START_OFFSET_MM, 2))
    sections: dict[str, dict[str, Any]] = {
        "": {"name": "drawn", "rig": "rig.toml", "robot": "robot.toml"},
        "path": path,
        "start": {"offset_mm": offset},
        "controller": {"law": law, "tolerance_mm": 0.8},
        "cycle": {"excite_cycles": int(rng.integers(3, 8)), "half_periods": int(rng.choice(HALF_PERIODS))},
        "localization": {"learn_ring_down": bool(rng.random() < 0.5)},
        "verdict": {"mean_tracking_mm": 0.5, "mean_localization_mm": 1.0},
        "stop": {"max_duration_s": limit},
    }
    drawn = {"law": law, "path": kind, "width_mm": round(width, 1), "height_mm": round(height, 1), "limit_s": limit}
    return _format_toml(sections), points, drawn


def _make_curves() -> dict[str, FloatArray]:
    """Make curves within -1 to 1: shape (n, 2) each."""
    a = np.linspace(0.0, 2.0 * np.pi, 120)
    away = np.linspace(0.15, 1.0, 200)
    round_twice = 4.0 * np.pi * (away - away[0])
    return {
        "circle": np.column_stack([np.cos(a), np.sin(a)]),
        "eight": np.column_stack([np.sin(a), np.sin(2.0 * a)]),
        "spiral": away[:, None] * np.column_stack([np.cos(round_twice), np.sin(round_twice)]),
        "wave": np.column_stack([a / np.pi - 1.0, np.sin(2.0 * a)]),
    }


_CURVES = _make_curves()


def _format_urdf(size: Sequence[float], mass: float) -> str:
    x, y, z = size
    inertia = mass / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    box = f'<geometry><box size="{x} {y} {z}"/></geometry>'
    moments = " ".join(f'i{a}{a}="{value:.4f}"' for a, value in zip("xyz", inertia, strict=True))
    return (
        f'<?xml version="1.0"?>\n<robot name="drawn"><link name="housing">\n'
        f'<inertial><mass value="{mass:.4f}"/><inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>\n'
        f"<visual>{box}</visual><collision>{box}</collision>\n</link></robot>\n"
    )


def _rounded(values: Any, decimals: int = 2) -> list[float]:
    return [float(v) for v in np.round(np.asarray(values, dtype=np.float64), decimals)]


def _format_toml(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """Format sections as TOML; the keys of "" stand before the first header."""
    lines = []
    for header, values in sections.items():
        lines += [f"\n[{header}]"] if header else []
        lines += [f"{key} = {_format_value(value)}" for key, value in values.items()]
    return "\n".join(lines) + "\n"


def _format_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return "[" + ", ".join(_format_value(v) for v in value) + "]"
    return repr(value)
