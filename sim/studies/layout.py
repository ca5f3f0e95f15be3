"""Sensor layouts over a volume: the rig's own, and one found by a search (N = 2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import RING_DOWN, load_rig_once, make_characterised_device
from sim.studies.layout_search import Layout, LayoutScorer, Search
from sim.studies.layout_value import AXES, Mismatch, Poses, Volume, evaluate_layout_value
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks
from smolbot.config.feasibility import make_noise_levels
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_matrix
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization.bounds import ListeningWindow
from smolbot.localization.expected_covariance import compute_expected_covariance

HALF_PERIODS = 2
NOISE_DRAWS = 4
"""Random directions of the mains, each learned; a layout is evaluated with all of them."""

TEST_DRAWS = 100
"""First noise draw for the final evaluation: other draws than the search used."""

SYSTEMATIC_WEIGHT = 0.1
"""Weight of the variance from misplaced sensors relative to that of noise: calibration removes most of it."""

DESCENTS = 4
"""Searches, each from its own start."""

PATIENCE = 400
"""Changes in a row that may fail before a descent ends."""

RANDOM_STARTS = 12
"""Random layouts of which the best is a start."""

CENTER_POSES, POSES_PER_PAPER = 8, 4
"""Orientations at the reference, and of so many poses one for estimator paper."""

ROUNDING = 1e-6
"""Deviation of an axis, and height in m, that are rounding."""

MAP_HEIGHT = 0.080
"""z of the map, in m."""

MIN_GAIN = 3
"""Improvement, in %, below which a layout counts as no better."""


def make_devices() -> dict[str, Device]:
    """Make the calibrated device with its moment across the cantilever, and along it.

    Returns
    -------
    dict of str to Device
    """
    across = make_characterised_device()
    along = Device(across.moment, np.array([0.0, 0.0, 1.0]), across.l0, across.theta_max, across.frequency,
                   across.damping, across.damping_model)  # fmt: skip
    return {"across": across, "along": along}


def make_window(rig: RigConfig) -> ListeningWindow:
    """Return the listening window.

    Parameters
    ----------
    rig : RigConfig

    Returns
    -------
    ListeningWindow
    """
    return ListeningWindow(HALF_PERIODS, rig.sample_rate, RING_DOWN)


def run_chunk(chunk: Chunk) -> Columns:
    """Run one descent: from the rig's own layout, or from the best of some random ones.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    rig = load_rig_once(chunk["rig"])
    poses = Volume().make_poses(3, 2, 0)
    scorer = LayoutScorer(
        tuple(make_devices().values()), make_noise_levels(rig), make_window(rig), poses, rig.sensors.bandwidth,
        Mismatch(), chunk["weight"], NOISE_DRAWS,
    )  # fmt: skip
    rng = np.random.default_rng(chunk.seed)
    own = find_layout(rig.sensors)
    start = (
        own
        if chunk["from_own"] and own is not None
        else scorer.find_best_of_random(len(rig.sensors), RANDOM_STARTS, rng)
    )
    search = Search(scorer, start, rng)
    search.run(chunk["patience"])
    return {
        "descent": np.array([chunk.name]),
        "score_um": np.array([1e6 * search.score]),
        "steps": np.array([search.steps]),
        "_places": search.layout.places[None],
        "_axes": search.layout.axes[None],
    }


def find_layout(sensors: SensorArray) -> Layout | None:
    """Convert an array to a `Layout`.

    Parameters
    ----------
    sensors : SensorArray

    Returns
    -------
    Layout or None
        None where a sensor lies off the plane or is not along an axis.
    """
    axes = np.argmax(np.abs(sensors.axes), axis=1)
    straight = bool(np.abs(sensors.axes[np.arange(len(axes)), axes]).min() > 1.0 - ROUNDING)
    flat = bool(np.abs(sensors.positions[:, 2]).max() < ROUNDING)
    return Layout(np.array(sensors.positions[:, :2]), axes) if straight and flat else None


def make_chunks(options: Options) -> list[Chunk]:
    """Make the descents; `poses` is their number.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    pieces = [
        (f"descent-{i:02d}", {"from_own": i == 0, "weight": SYSTEMATIC_WEIGHT, "patience": PATIENCE})
        for i in range(options.poses or DESCENTS)
    ]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compare the best layout with the rig's own, on poses and noise that the search did not use.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    rig = load_rig_once(options.rig)
    best = min(parts, key=lambda part: float(part["score_um"][0]))
    found = Layout(best["_places"][0], best["_axes"][0])
    proposed = {"rig": rig.sensors, "found": found.to_sensors(rig.sensors.bandwidth)}
    poses = Volume().make_poses(4, 2, 1)
    values = {name: evaluate_layout(sensors, rig, poses) for name, sensors in proposed.items()}
    toml = format_toml(found)
    rows: list[tuple[str, str]] = []
    for name, one in values.items():
        rows.append((f"{name} layout", ""))
        rows += [(f"  {label}", one[key + "_text"]) for key, label in LABELS.items()]
    rows.append(("found layout, to paste into [sensors]", ""))
    rows += [(f"  {line.partition(' = ')[0]}", line.partition(" = ")[2]) for line in toml.splitlines()]
    figures = {
        "layouts": {n: {k: v for k, v in one.items() if not k.endswith("_text")} for n, one in values.items()},
        "found": {"positions_mm": np.round(1e3 * proposed["found"].positions, 1).tolist(),
                  "axes": ["xyz"[a] for a in found.axes]},
        "toml": toml,
        "ratio": values["found"]["bound_um"] / values["rig"]["bound_um"],
    }  # fmt: skip
    columns: Columns = {key: np.concatenate([p[key] for p in parts]) for key in ("descent", "score_um", "steps")}
    for name, sensors in proposed.items():
        columns[f"_map_{name}"] = compute_bound_map(sensors, rig)
        columns[f"_places_{name}"], columns[f"_axes_{name}"] = sensors.positions, sensors.axes
    return Outcome(rows, figures, columns)


LABELS = {
    "bound": "bound, rms per axis over the volume",
    "reference": "bound at (0, 0, 80 mm)",
    "correlation": "correlation of z with amplitude",
    "systematic": "sensor errors of 0.2 mm, 0.5 %, 0.3 deg",
    "paper": "estimator paper, rms per axis",
}


def evaluate_layout(sensors: SensorArray, rig: RigConfig, poses: Poses) -> dict[str, Any]:
    """Compute the figures of one layout, over both devices and all noise environments.

    Parameters
    ----------
    sensors : SensorArray
    rig : RigConfig
    poses : Poses

    Returns
    -------
    dict
    """
    levels, listened = make_noise_levels(rig), make_window(rig)
    center = Poses(np.array([[0.0, 0.0, MAP_HEIGHT]] * CENTER_POSES), Volume().make_poses(2, 1, 2).rotations)
    bound, reference, systematic, correlation, paper = [], [], [], [], []
    for device in make_devices().values():
        for room in range(NOISE_DRAWS):
            noise = levels.sample_room_model(sensors, TEST_DRAWS + room)
            value = evaluate_layout_value(sensors, device, noise, listened, poses, Mismatch())
            bound.append(value.bound.position_rms)
            systematic.append(value.systematic_rms)
            correlation.append(np.abs(value.bound.height_amplitude_correlation))
            reference.append(
                evaluate_layout_value(sensors, device, noise, listened, center, Mismatch()).bound.position_rms
            )
        for place, turn in zip(poses.positions[::POSES_PER_PAPER], poses.rotations[::POSES_PER_PAPER], strict=True):
            pose = Pose(0.0, place, quaternion_from_matrix(turn), np.eye(6))
            covariance = compute_expected_covariance(
                sensors, device, levels, pose, HALF_PERIODS, listened.sample_rate, listened.since
            )
            paper.append(np.sqrt(np.trace(covariance[:3, :3]) / 3.0))
    out: dict[str, Any] = {
        "bound_um": 1e6 * _compute_rms(bound), "reference_um": 1e6 * _compute_rms(reference),
        "systematic_um": 1e6 * _compute_rms(systematic), "correlation": float(np.median(correlation)),
        "worst_correlation": float(np.max(correlation)),
        "paper_um": 1e6 * _compute_rms(paper), "worst_bound_um": 1e6 * float(np.max(bound)),
    }  # fmt: skip
    out |= {
        "bound_text": f"{out['bound_um']:.0f} µm (worst pose {out['worst_bound_um']:.0f} µm)",
        "reference_text": f"{out['reference_um']:.0f} µm, rms over orientations",
        "correlation_text": f"{out['correlation']:.3f} (median; worst {out['worst_correlation']:.3f})",
        "systematic_text": f"{out['systematic_um']:.0f} µm, uncalibrated, to first order",
        "paper_text": f"{out['paper_um']:.0f} µm",
    }
    return out


def _compute_rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def format_toml(layout: Layout) -> str:
    """Format a layout as lines of the ``[sensors]`` section of a rig file.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    str

    Examples
    --------
    >>> print(format_toml(Layout(np.array([[0.01, -0.02], [0.0, 0.03]]), np.array([2, 0]))))
    positions_mm = [[10, -20, 0], [0, 30, 0]]
    axes = ["z", "x"]
    """
    order = np.lexsort((layout.places[:, 1], layout.places[:, 0], -layout.axes))
    places = ", ".join(f"[{1e3 * x:.0f}, {1e3 * y:.0f}, 0]" for x, y in layout.places[order] + 0.0)
    axes = ", ".join(f'"{"xyz"[a]}"' for a in layout.axes[order])
    return f"positions_mm = [{places}]\naxes = [{axes}]"


MAP = np.linspace(-0.02, 0.02, 9)
"""x and y of the map, in m."""


def compute_bound_map(sensors: SensorArray, rig: RigConfig) -> FloatArray:
    """Compute the bound over `MAP` at `MAP_HEIGHT`, over both devices, four orientations and two noise environments.

    Parameters
    ----------
    sensors : SensorArray
    rig : RigConfig

    Returns
    -------
    ndarray, shape (len(MAP), len(MAP)), in µm
        Rows are y.
    """
    places = np.array([[x, y, MAP_HEIGHT] for y in MAP for x in MAP])
    turns = Volume().make_poses(2, 1, 3).rotations[:4]
    poses = Poses(np.repeat(places, len(turns), axis=0), np.tile(turns, (len(places), 1, 1)))
    found = [
        evaluate_layout_value(
            sensors,
            device,
            make_noise_levels(rig).sample_room_model(sensors, TEST_DRAWS + room),
            make_window(rig),
            poses,
            Mismatch(),
        ).bound
        for device in make_devices().values()
        for room in range(2)
    ]
    squares = np.mean([b.position_rms**2 for b in found], axis=0).reshape(len(places), len(turns)).mean(axis=1)
    errors: FloatArray = 1e6 * np.sqrt(squares).reshape(len(MAP), len(MAP))
    return errors


def draw(outcome: Outcome, path: Path) -> None:
    """Draw both layouts, and the bound that each gives at 80 mm.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import OTHERS, open_slide, set_titles

    figures, columns = outcome.figures, outcome.columns
    before, after = figures["layouts"]["rig"], figures["layouts"]["found"]
    less = [round(100 * (1 - after[key] / before[key])) for key in ("bound_um", "systematic_um")]
    headline = f"Better sensor positions: {less[0]} % less error by noise, {less[1]} % less by sensor errors"
    if max(less) < MIN_GAIN:
        headline = "No better sensor positions found than those of the rig file"
    subline = "Cramer-Rao bound, rms per axis, N = 2, |x|, |y| ≤ 20 mm, z 50 to 100 mm, moment across and along"
    both = np.concatenate([columns["_map_rig"], columns["_map_found"]])
    colors = dict(zip("xyz", (OTHERS[1], OTHERS[3], "#1d4e6b"), strict=True))
    edge = 1e3 * float(MAP[-1])
    with open_slide(path, headline, subline, 1, 2, wspace=0.3, left=0.06, right=0.9) as axes:
        for panel, (name, title) in zip(axes, (("rig", "rig file"), ("found", "found")), strict=True):
            image = panel.imshow(
                columns[f"_map_{name}"], origin="lower", extent=(-edge, edge, -edge, edge), cmap="YlGnBu",
                vmin=both.min(), vmax=both.max(), interpolation="bilinear", zorder=1,
            )  # fmt: skip
            style: dict[str, Any] = {
                "color": "white",
                "ha": "center",
                "va": "center",
                "fontweight": "bold",
                "zorder": 4,
            }
            for place, axis in zip(1e3 * columns[f"_places_{name}"], columns[f"_axes_{name}"], strict=True):
                letter = "xyz"[int(np.argmax(np.abs(axis)))]
                panel.plot(place[0], place[1], "o", ms=19, color=colors[letter], mec="white", mew=1.5, zorder=3)
                panel.text(place[0], place[1], letter, **style)
            one = figures["layouts"][name]
            text = f"{title}: noise {one['bound_um']:.0f} µm, sensor errors {one['systematic_um']:.0f} µm"
            set_titles(panel, text, "x in mm", "y in mm")
            panel.set(xlim=(-80, 80), ylim=(-80, 80), aspect="equal")
        bar = axes[1].inset_axes((1.06, 0.0, 0.04, 1.0))
        axes[1].figure.colorbar(image, cax=bar, label="bound at z = 80 mm, in µm")


STUDY = Study(
    name="layout",
    title="Sensor layout: the bound over a volume, N = 2",
    devices=make_devices,
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={
        "volume_mm": [[1e3 * v for v in Volume().low], [1e3 * v for v in Volume().high]],
        "half_periods": HALF_PERIODS, "rooms": NOISE_DRAWS, "weight": SYSTEMATIC_WEIGHT, "axes": AXES.tolist(),
        "square_mm": 150.0, "apart_mm": 10.0,
    },
)  # fmt: skip
