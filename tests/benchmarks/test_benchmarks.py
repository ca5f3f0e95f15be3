"""Speeds, as ratios measured in one run: printed by ``make benchmark``, never asserted."""

from __future__ import annotations

import time
from contextlib import closing
from statistics import median

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from controllers import ForceAllocator
from sim.batch.executors import open_executor
from sim.batch.flights import PlantModel, compute_warm_rates, fly_seeds
from sim.measure.plant_speed import measure_plant_loads
from sim.reduced.plant import ReducedPlant
from sim.reduced.rig import open_reduced
from sim.tank.settings import TankSettings
from sim.tank.world import TankWorld
from smolbot.config.document import validate
from smolbot.config.mission import load_steering_mission
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.shots import Rest
from smolbot.flight.preview.rollout import Rollout, RolloutParts
from smolbot.flight.session import fly
from smolbot.localization.chain import apply_filters
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer

RATE = 50_000.0


def seconds(action, repeats: int) -> float:
    """Median time of one call, after one to warm up."""
    action()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return median(times)


def numpy_fit(sensors, device, recording, prior):
    """The same fit as `locate`, written down plainly: numpy, and scipy's Levenberg-Marquardt."""
    n = recording.field.shape[1]
    time_ = recording.time_since_drive + np.arange(n) / RATE
    points = np.round(np.linspace(25, n - 26, 9)).astype(int)
    groups = [np.flatnonzero(np.all(np.isclose(sensors.axes, axis), axis=1)) for axis in np.eye(3)]

    def chain(field):
        return np.concatenate(
            [apply_filters(field[g[1:]] - field[g[0]], RATE)[:, points].ravel() for g in groups if len(g) > 1]
        )

    data = chain(recording.field)
    scale = np.array([1e-3] * 3 + [0.1] * 5)

    def residual(x):
        move = x * scale
        q = multiply_quaternions(quaternion_from_rotation_vector(move[3:6]), prior.orientation)
        theta = compute_deflection(device, time_, 0.7 * device.theta_max + move[7], 0.4 + move[6])
        return (chain(compute_sensor_field(sensors, device, prior.position + move[:3], q, theta)) - data) * 1e5

    return least_squares(residual, np.zeros(8), method="lm")


@pytest.mark.benchmark(group="locate")
@pytest.mark.parametrize("half_periods", [1, 2, 20])
def test_locate_warm(benchmark, array, along_device, pose_at, hear, half_periods):
    truth = pose_at((4, -6, 80), 35)
    recording = hear(array, along_device, truth, half_periods)
    localizer = Localizer(array, along_device, estimator="paper")
    pose = benchmark(localizer.locate, recording, truth)
    assert np.linalg.norm(pose.position - truth.position) < 1e-5


@pytest.mark.benchmark(group="ratios")
def test_locate_against_the_same_fit_by_numpy_and_scipy(benchmark, array, along_device, pose_at, hear):
    truth = pose_at((4, -6, 80), 35)
    noise = 1e-10 * np.random.default_rng(0).normal(size=(10, 483))
    recording = hear(array, along_device, truth, noise=noise)
    localizer = Localizer(array, along_device, estimator="paper")
    found = benchmark.pedantic(lambda: numpy_fit(array, along_device, recording, truth), rounds=3, iterations=1)
    ours = localizer.locate(recording, truth)
    assert np.linalg.norm(1e-3 * found.x[:3] - (ours.position - truth.position)) < 1e-3
    plain = seconds(lambda: numpy_fit(array, along_device, recording, truth), 5)
    fast = seconds(lambda: localizer.locate(recording, truth), 200)
    print(f"\nlocate, N = 2, warm: {fast * 1e3:.3f} ms; numpy and scipy {plain * 1e3:.1f} ms: {plain / fast:.0f} times")


@pytest.mark.benchmark(group="ratios")
def test_real_time_factor_of_the_tank_and_the_share_of_localization(benchmark):
    short = load_steering_mission("line", settings={"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]"})
    fly(short, 1)
    run = benchmark.pedantic(fly, (short, 2), rounds=1, iterations=1)
    computing = sum(c.compute for c in run.cycles)
    print(
        f"\ntank: {run.duration / run.wall:.0f} times real time over {run.duration:.1f} s; "
        f"localization, tracking and control take {computing / run.wall:.0%} of the time, the world the rest"
    )
    assert run.status == "completed"


@pytest.mark.benchmark(group="ratios")
def test_an_allocation_against_one_start_of_slsqp(benchmark):
    setup = load_steering_mission("line").setup()
    allocator = ForceAllocator(setup.table, 8.0, setup.robot.moment, least_field=1e-3)
    here, way = np.array([4e-3, 2e-3, 0.06]), np.array([0.6, 0.8, 0.0])
    b, g = setup.table.field(here[None])[:, 0], setup.table.gradient(here[None])[:, 0]

    def pull(currents):
        field = currents @ b
        return field, np.einsum("c,cij,i->j", currents, g, field)[:2] / np.linalg.norm(field)

    def plain():
        rules = [
            {"type": "eq", "fun": lambda i: way[0] * pull(i)[1][1] - way[1] * pull(i)[1][0]},
            {"type": "ineq", "fun": lambda i: 1e3 * np.linalg.norm(pull(i)[0]) - 1.0},
        ]
        start = np.array([4.0, 1.0, 5.0, 2.0])
        return minimize(lambda i: -pull(i)[1] @ way[:2], start, method="SLSQP", bounds=[(0, 8)] * 4, constraints=rules)

    benchmark.pedantic(plain, rounds=3, iterations=1)
    slow, fast = seconds(plain, 10), seconds(lambda: allocator.currents(here, way), 200)
    print(
        f"\nallocation: {fast * 1e3:.3f} ms; scipy's SLSQP from one start {slow * 1e3:.1f} ms: {slow / fast:.0f} times"
    )


@pytest.mark.benchmark(group="ratios")
def test_a_step_of_predictive_control_against_the_turnaround(benchmark):
    mission = load_steering_mission("r_path")
    rollout = Rollout(RolloutParts.prepare(mission))
    law, times = rollout.controller, []
    real = law.command

    def timed(pose):
        begin = time.perf_counter()
        command = real(pose)
        times.append(time.perf_counter() - begin)
        return command

    law.command = timed
    assert benchmark.pedantic(rollout.fly, rounds=1, iterations=1).reason == ""
    middle, most = 1e3 * np.median(times), 1e3 * np.percentile(times, 99)
    print(
        f"\npredictive: {middle:.2f} ms a step, p99 {most:.2f} ms, of {1e3 * mission.rig.turnaround:g} ms of turnaround"
    )


@pytest.mark.benchmark(group="ratios")
def test_reduced_plant_against_the_full_tank_and_the_loop_around_it(benchmark):
    """By processor time, since other programs share the machine."""
    mission = load_steering_mission("line")
    run = fly(mission, 1, opener=open_reduced)
    shots = [c.shot for c in run.cycles]
    rigs = {"full": lambda: TankWorld.open(mission.rig, mission.robot, mission.start, 1),
            "reduced": lambda: open_reduced(mission, 1)}  # fmt: skip
    factors = {}
    for name, opened in rigs.items():
        with closing(opened()) as rig:
            if name == "reduced":
                rig.make_synthetic_localizer(Localizer(rig.sensors, mission.robot.device))
            rig.play(shots[0])
            begin, clock = time.process_time(), rig.now()
            for shot in shots:
                rig.play(shot)
            factors[name] = (rig.now() - clock) / (time.process_time() - begin)
    settings, _ = validate(TankSettings, mission.rig.sections.tank, ("tank",))
    plant = ReducedPlant(mission.rig, mission.robot, settings, np.array(mission.start), 1)
    moves = [(*shot.windows, Rest(mission.rig.turnaround)) for shot in shots]
    begin = time.process_time()
    for windows in moves:
        plant.advance(windows)
    factors["motion alone"] = plant.time / (time.process_time() - begin)
    begin = time.process_time()
    flown = benchmark.pedantic(fly, (mission, 1), {"opener": open_reduced}, rounds=3, iterations=1)
    factors["reduced, a whole flight"] = 3.0 * flown.duration / (time.process_time() - begin)
    print("\ntimes real time: " + "; ".join(f"{name} {factor:.0f}" for name, factor in factors.items()))
    print(f"the reduced plant plays {factors['reduced'] / factors['full']:.0f} times as fast as the full tank")
    assert flown.status == "completed"


@pytest.mark.benchmark(group="ratios")
def test_flights_a_minute_of_the_reduced_plant_with_one_process_and_with_two(benchmark):
    """In pairs, since other programs share the machine; workers warm, each pair over seeds of its own."""

    count, rounds = (3, 1) if benchmark.disabled else (12, 3)

    def rates(jobs, first):
        with open_executor(jobs) as executor:
            done = list(fly_seeds(executor, "r_path", None, {}, list(range(first, first + count)), PlantModel.REDUCED))
        assert all(f.summary["status"] == "completed" for f in done)
        return compute_warm_rates(done)

    benchmark.pedantic(rates, (1, 1), rounds=1, iterations=1)
    pairs = [(rates(1, 10 * k), rates(2, 10 * k)) for k in range(1, rounds + 1)]
    for name, what, cores in (("warm", "by the wall's clock", 1), ("per_processor", "by processor time", 2)):
        ones, twos = ([pair[i][name] * (1 if i == 0 else cores) for pair in pairs] for i in (0, 1))
        ratios = ", ".join(f"{two / one:.2f}" for one, two in zip(ones, twos))
        print(
            f"\nr_path, reduced plant, flights a minute, {what}: {max(ones):.0f} with one process, {max(twos):.0f} "
            f"with two; two over one, pair by pair: {ratios}"
        )


@pytest.mark.benchmark(group="ratios")
@pytest.mark.parametrize(("rig", "robot"), [("tank", "gradient"), ("gel", "helical")])
def test_share_of_a_processor_that_the_plant_of_the_twin_takes(benchmark, rig, robot):
    loads = benchmark.pedantic(measure_plant_loads, (rig, robot), rounds=1, iterations=1)
    for state, share in loads.items():
        print(f"\nplant of the twin, {rig}, {state}: {100 * share:.1f} % of a processor", end="")
