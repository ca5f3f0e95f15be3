"""Flights with drawn faults: what fails, how badly, when and for how long is sampled from a seed.

``python -m tests.sim.batch.drawn_faults --seeds 0..99`` flies them, one line each, and ends with 1 if a flight raised
an error or trusted a pose that was off by more than 2 mm; ``--fault`` flies one fault over the seeds instead.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.batch.command import parse_seeds
from sim.batch.executors import open_executor
from smolbot.config.load import load_mission
from smolbot.core.rig import Witness
from smolbot.flight.session import fly, open_rig

MISSION = "r_path"

MAX_ERROR = 2e-3
"""Distance, in m, from the truth beyond which a trusted pose is wrong."""

FIRST, LAST = 12.0, 55.0
"""Times, in s after the first shot, between which faults begin: the noise is learned by then, the path not flown."""

STREAM = 7
"""Random stream of a seed for the faults; the tank, the twin and its spikes use 0 to 6."""

TWO_FAULTS = 0.3
"""Share of flights with two faults."""

SENSOR_FAULTS: dict[str, tuple[float, float]] = {
    "sensor_offset": (1.0, 3e4), "sensor_drift": (1.0, 3e3), "sensor_hum": (1.0, 3e3), "sensor_noise": (2.0, 300.0),
    "sensor_spikes": (10.0, 5e3), "sensor_clipped": (1.0, 300.0),
}  # fmt: skip
"""Faults of a sensor, and between what their value lies, evenly in its logarithm."""

PLANT_FAULTS: dict[str, tuple[float, float]] = {
    "drag": (0.5, 2.0), "rotation_drag": (0.5, 2.0), "viscosity": (0.5, 2.0), "coil_gain": (0.7, 1.3),
    "damping": (0.5, 2.0), "moment": (0.7, 1.3), "excitation_gain": (0.3, 1.5),
}  # fmt: skip

PLAIN_FAULTS = (
    "sensor_dead", "sensor_frozen", "sensors_saturated", "sensor_gain", "sensor_stuck_bit", "sensors_swapped",
    "all_saturated", "windows_lost", "excitation_lost", "coil_dead", "resonance_shift",
)  # fmt: skip


@dataclass(frozen=True)
class FaultedFlight:
    """One flight with faults, and how far its trusted poses were off.

    Attributes
    ----------
    seed : int
    faults : tuple of str
    error : str
        Type and text of an exception that came out of it; empty if none did.
    status, reason, verdict : str
    wrong_located, wrong_tracked : int
        Trusted poses off by more than `MAX_ERROR`.
    worst_located, worst_tracked : float, in m
    mean_located, mean_tracked : float, in m
        nan if there was no such pose.
    tracking_rms : float, in mm
    """

    seed: int
    faults: tuple[str, ...]
    error: str = ""
    status: str = ""
    reason: str = ""
    verdict: str = ""
    wrong_located: int = 0
    wrong_tracked: int = 0
    worst_located: float = 0.0
    worst_tracked: float = 0.0
    mean_located: float = float("nan")
    mean_tracked: float = float("nan")
    tracking_rms: float = float("nan")

    @property
    def bad(self) -> bool:
        """Whether it raised an error, or trusted a wrong pose."""
        return bool(self.error or self.wrong_located or self.wrong_tracked)

    def __str__(self) -> str:
        outcome = self.error or f"{self.status}: {self.reason}"
        return (
            f"{'BAD ' if self.bad else ''}{self.seed:3d} {' '.join(self.faults)} | {outcome} | {self.verdict}, "
            f"rms {self.tracking_rms:.2f} mm; located and tracked: wrong {self.wrong_located}, {self.wrong_tracked}; "
            f"at worst {1e3 * self.worst_located:.2f}, {1e3 * self.worst_tracked:.2f} mm; "
            f"mean {1e3 * self.mean_located:.2f}, {1e3 * self.mean_tracked:.2f} mm"
        )


def draw_faults(seed: int, n_sensors: int = 10, coils: tuple[str, ...] = ("+x", "-x", "+y", "-y")) -> tuple[str, ...]:
    """Draw the faults of a flight.

    Parameters
    ----------
    seed : int
    n_sensors : int
    coils : tuple of str

    Returns
    -------
    tuple of str
        One or two, as ``--fault`` takes them.
    """
    rng = np.random.default_rng([seed, STREAM])
    return tuple(_draw_fault(rng, n_sensors, coils) for _ in range(2 if rng.random() < TWO_FAULTS else 1))


def _draw_fault(rng: np.random.Generator, n_sensors: int, coils: tuple[str, ...]) -> str:
    ranged = {**SENSOR_FAULTS, **PLANT_FAULTS}
    name = str(rng.choice([*ranged, *PLAIN_FAULTS]))
    sensor, other = rng.choice(n_sensors, 2, replace=False)
    moment = f"@{rng.uniform(FIRST, LAST):.1f}s"
    lasting = str(rng.choice(["", ":once", f":{rng.uniform(1.0, 10.0):.1f}"]))
    if name in ranged:
        value = np.exp(rng.uniform(*np.log(ranged[name])))
        head = f"{name}.{sensor}={value:.3g}" if name in SENSOR_FAULTS else f"{name}={value:.3g}"
        if name == "sensor_hum":
            head += f",{rng.choice([50.0, 100.0, 103.5, rng.uniform(20.0, 400.0)]):.1f}"
    elif name == "sensor_gain":
        head = f"{name}.{sensor}={rng.uniform(-1.0, 2.0):.2f}"
    elif name == "sensor_stuck_bit":
        head = f"{name}.{sensor}={rng.integers(0, 16)}"
    elif name == "sensors_swapped":
        head = f"{name}.{sensor}={other}"
    elif name == "all_saturated":
        head = "sensors_saturated"
    elif name == "coil_dead":
        head = f"{name}.{rng.choice(coils)}"
    elif name == "resonance_shift":
        head = f"{name}={rng.uniform(-3.0, 3.0):.2f}"
    elif name in ("sensor_dead", "sensor_frozen", "sensors_saturated"):
        head = f"{name}.{sensor}"
    else:  # windows and excitation: with nothing left to hear, only a time helps
        head = name
    return head + moment + lasting


def fly_with_faults(seed: int, faults: tuple[str, ...], mission: str = MISSION) -> FaultedFlight:
    """Fly a mission with faults, and compare every trusted pose with the truth.

    Parameters
    ----------
    seed : int
        Of the tank.
    faults : tuple of str
    mission : str

    Returns
    -------
    FaultedFlight
    """
    loaded = load_mission(mission, None, {"rig.tank.faults": json.dumps(faults)})
    witnesses: list[Witness] = []

    def open_witnessed(mission: Any, seed: int) -> Any:
        rig: Any = open_rig(mission, seed)
        witnesses.append(rig.witness)
        return rig

    try:
        run = fly(loaded, seed, opener=open_witnessed)
    except Exception as error:
        return FaultedFlight(seed, faults, f"{type(error).__name__}: {error}")
    truth = witnesses[0].truth
    poses = {
        "located": [c.trusted for c in run.cycles if c.trusted is not None],
        "tracked": [c.tracked for c in run.cycles if c.tracked is not None and c.tracked.trusted],
    }
    figures: dict[str, Any] = {}
    for kind, found in poses.items():
        errors = np.array([np.linalg.norm(pose.position - truth(pose.time).position) for pose in found])
        figures[f"wrong_{kind}"] = int(np.sum(errors > MAX_ERROR))
        figures[f"worst_{kind}"] = float(errors.max(initial=0.0))
        figures[f"mean_{kind}"] = float(errors.mean()) if errors.size else float("nan")
    tracking: Any = run.summary.get("tracking_error_mm", {})
    return FaultedFlight(
        seed, faults, "", run.status, run.stop_reason, str(run.summary["verdict"]), **figures,
        tracking_rms=tracking.get("rms", float("nan")),
    )  # fmt: skip


def summarize(flights: Sequence[FaultedFlight]) -> str:
    """Summarize flights in a few lines.

    Parameters
    ----------
    flights : sequence of FaultedFlight

    Returns
    -------
    str
    """
    counts = Counter(flight.status or "exception" for flight in flights)
    rms = [flight.tracking_rms for flight in flights if flight.status == "completed"] or [float("nan")]
    located, tracked = (
        1e3 * np.nanmean([getattr(f, name) for f in flights]) for name in ("mean_located", "mean_tracked")
    )
    wrong = [sum(getattr(f, name) for f in flights) for name in ("wrong_located", "wrong_tracked")]
    return (
        f"{len(flights)} flights: {dict(counts)}; passed {sum(f.verdict == 'passed' for f in flights)}; wrong poses "
        f"trusted: {wrong[0]} located, {wrong[1]} tracked, in {sum(f.bad for f in flights)} flights; tracking rms of "
        f"the completed {np.mean(rms):.3f} mm; mean error located {located:.3f} mm, tracked {tracked:.3f} mm"
    )


def main() -> int:
    """Fly the drawn faults of some seeds, or given faults over them; print one line each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", default="0..99", help="A..B")
    parser.add_argument("--fault", action="append", help="fly these instead of drawn ones")
    parser.add_argument("--mission", default=MISSION)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    flights = []
    with open_executor(options.jobs) as pool:
        futures = [
            pool.submit(fly_with_faults, seed, tuple(options.fault or draw_faults(seed)), options.mission)
            for seed in parse_seeds(options.seeds)
        ]
        for future in as_completed(futures):
            flights.append(future.result())
            print(flights[-1], flush=True)
    print(summarize(flights))
    return 1 if any(flight.bad for flight in flights) else 0


if __name__ == "__main__":
    sys.exit(main())
