"""A study of one's own: error of a pose against recording time, over random tanks, with a table and a figure."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import smolbot
from sim import TankWorld
from sim.studies import Chunk, Columns, Options, Outcome, Study, cut_chunks, run_study

HALF_PERIODS = (2, 6, 20)
TANKS = 3


def work(chunk: Chunk) -> Columns:
    """Errors of poses in one random tank: a row for each recording time."""
    rig, robot = smolbot.load_rig(chunk["rig"]), smolbot.load_robot("gradient")
    frequency, errors = robot.device.frequency, []
    with TankWorld.open(rig, robot, (0.0, 0.0), chunk.seed) as tank:
        localizer = smolbot.Localizer(tank.sensors, robot.device)
        for count in HALF_PERIODS:
            listen = smolbot.RingDown(0.02), smolbot.Listen(count, frequency)
            recording = tank.play(smolbot.Shot((smolbot.Excite((5.0, 5.0), frequency, 5), *listen)))
            pose = localizer.locate(recording)
            errors.append(1e3 * np.linalg.norm(pose.position - tank.witness.truth(pose.time).position))
    return {"half_periods": np.array(HALF_PERIODS), "error_mm": np.array(errors)}


def chunks(options: Options) -> list[Chunk]:
    """One chunk for each tank, with its own seed."""
    return cut_chunks(options, work, [(f"tank-{i}", {}) for i in range(options.poses or TANKS)])


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Mean error for each recording time."""
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    means = {n: float(columns["error_mm"][columns["half_periods"] == n].mean()) for n in HALF_PERIODS}
    rows = [(f"{n} half-periods", f"{mean:.2f} mm on average") for n, mean in means.items()]
    return Outcome(rows, {"error_mm": {str(n): mean for n, mean in means.items()}}, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Every error against the recording time."""
    plt.figure()
    plt.plot(outcome.columns["half_periods"], outcome.columns["error_mm"], "o")
    plt.xlabel("recording time, in half-periods")
    plt.ylabel("error of the pose, in mm")
    plt.savefig(path)


STUDY = Study(
    "listening", "Error against recording time", lambda: {"gradient": smolbot.load_robot("gradient").device},
    chunks, conclude, draw,
)  # fmt: skip

if __name__ == "__main__":
    outcome, folder = run_study(STUDY, Options(STUDY.name, seed=1, jobs=1), Path("listening"))
    print("\n".join(f"{name}: {value}" for name, value in outcome.rows))
    print("figure and results.csv in", folder)
