"""The reduced plant goes where the full tank goes, drawn from the same seed and given the same commands."""

from __future__ import annotations

import numpy as np
import pytest

from sim.reduced.kernel import compute_plane_field
from sim.reduced.plant import ReducedPlant, _tabulate_plane
from sim.reduced.rig import open_reduced
from sim.tank.magnetics.cantilever import compute_fields
from sim.tank.magnetics.tank_coils import TankCoils
from sim.tank.settings import TankSettings
from sim.tank.tank import Tank
from smolbot.config.document import validate
from smolbot.config.mission import load_steering_mission
from smolbot.core.shots import Actuate, Listen, Rest
from smolbot.flight.session import fly


def settings_of(mission):
    settings, faults = validate(TankSettings, mission.rig.sections.tank, ("tank",))
    assert not faults
    return settings


def commands_of(mission, seed):
    """The windows of a flight, shot by shot, as its controller came to command them."""
    run = fly(mission, seed, opener=open_reduced)
    return [(Rest(run.begun),), *[(*c.shot.windows, Rest(mission.rig.turnaround)) for c in run.cycles]]


def ways(mission, seed, shots):
    """True rotation centres (n, 3) and orientations (n, 4) at the shots' ends, in the full tank and the reduced."""
    found = []
    for plant in (Tank, ReducedPlant):
        one = plant(mission.rig, mission.robot, settings_of(mission), np.array(mission.start), seed)
        poses = []
        for shot in shots:
            one.advance(shot)
            poses.append(one.history.interpolate_pose(one.time))
        found.append(np.array(poses))
        assert one.time == pytest.approx(sum(w.duration for shot in shots for w in shot))
    return found


@pytest.fixture(scope="module")
def letter():
    return load_steering_mission("r_small", settings={"localization.quiet_s": "3.0", "stop.max_duration_s": "20.0"})


@pytest.fixture(scope="module")
def doubled():
    """Long windows across the tank, with every mismatch doubled."""
    return load_steering_mission(
        "line",
        settings={
            "path.points_mm": "[[-9.0, -7.0], [6.0, 8.0], [6.0, -8.0]]",
            "controller.gains.t_min_ms": "70.0",
            "rig.tank.mismatch.scale": "2.0",
            "localization.quiet_s": "2.0",
            "stop.max_duration_s": "15.0",
        },
    )


@pytest.mark.parametrize(("name", "seed"), [("line", 1), ("line", 2), ("letter", 3), ("doubled", 5)])
def test_same_commands_and_seed_lead_along_the_full_tanks_way_within_a_tenth_of_a_millimetre(name, seed, request):
    mission = request.getfixturevalue(name)
    full, reduced = ways(mission, seed, commands_of(mission, seed))
    apart = np.linalg.norm(full[:, :3] - reduced[:, :3], axis=1)
    travelled = np.linalg.norm(np.diff(full[:, :2], axis=0), axis=1).sum()
    rms = float(np.sqrt(np.mean(apart**2)))
    print(f"\n{name}, seed {seed}: {travelled * 1e3:.1f} mm in {len(full)} shots, apart {rms * 1e3:.4f} mm rms")
    assert travelled > 5e-3
    assert rms < 0.03e-3  # a drag that is 1 % off makes 0.15 mm in half a minute
    assert apart.max() < 0.1e-3
    turned = 2.0 * np.arccos(np.clip(np.abs(np.sum(full[:, 3:] * reduced[:, 3:], axis=1)), 0.0, 1.0))
    assert np.sqrt(np.mean(turned**2)) < np.radians(2.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_commands_of_a_complete_letter_still_follow_the_full_tanks_path(seed):
    mission = load_steering_mission("r_small")
    full, reduced = ways(mission, seed, commands_of(mission, seed))
    apart = np.linalg.norm(full[:, :3] - reduced[:, :3], axis=1)
    print(f"\nseed {seed}: apart {np.sqrt(np.mean(apart**2)) * 1e3:.4f} mm rms, {apart.max() * 1e3:.4f} mm at most")
    assert np.sqrt(np.mean(apart**2)) < 0.1e-3


@pytest.mark.parametrize("coil", [0, 3])
def test_a_wall_holds_the_robot_where_the_tanks_does(line, coil):
    currents = tuple(8.0 * (np.arange(4) == coil))
    full, reduced = ways(line, 6, [(Actuate(currents, 0.1),)] * 150)
    assert np.abs(full[-1, :2]).max() > 15e-3
    assert np.linalg.norm(full[-1, :2] - reduced[-1, :2]) < 1e-3


def test_a_liquid_that_flows_and_rotates_carries_the_robot_as_the_tanks_does():
    flow = {"rig.medium.flow_mm_s": "1.5", "rig.tank.flow.rotating_percent": "40.0"}
    mission = load_steering_mission("line", settings=flow)
    full, reduced = ways(mission, 6, [(Rest(0.5), Actuate((4.0, 0.0, 0.0, 2.0), 0.05))] * 6)
    assert np.linalg.norm(full[-1, :2] - full[0, :2]) > 1e-3
    assert np.linalg.norm(full[-1, :2] - reduced[-1, :2]) < 0.03e-3


def test_other_seeds_and_doubled_mismatches_lead_elsewhere(line):
    shots = [(Actuate((8.0, 0.0, 3.0, 0.0), 0.1),)] * 20

    def end(seed, scale):
        settings = settings_of(line)
        settings = settings.model_copy(
            update={"mismatch": settings.mismatch.model_copy(update={"scale": scale}), "start_scatter_mm": 0.0}
        )
        plant = ReducedPlant(line.rig, line.robot, settings, np.zeros(2), seed)
        for shot in shots:
            plant.advance(shot)
        return plant.history.interpolate_pose(plant.time)[:2]

    ideal, once, twice = (end(3, scale) for scale in (0.0, 1.0, 2.0))
    off, doubled = np.linalg.norm(once - ideal), np.linalg.norm(twice - ideal)
    assert off > 0.05e-3
    assert 1.4 < doubled / off < 3.0
    assert not np.allclose(end(4, 1.0), once, atol=1e-5)


def test_the_way_does_not_depend_on_how_a_rest_is_divided(line):
    def end(rests):
        plant = ReducedPlant(line.rig, line.robot, settings_of(line), np.zeros(2), 2)
        plant.advance((Actuate((8.0, 0.0, 0.0, 0.0), 0.05), *rests))
        return plant.history.interpolate_pose(plant.time)

    whole, parts = end([Rest(0.2)]), end([Rest(0.05), Listen(2, 103.5), Rest(0.15 - 1 / 103.5)])
    assert np.linalg.norm(whole[:3] - parts[:3]) < 1e-6


def test_field_of_the_plane_is_that_of_the_sampled_coils_near_it(line):
    tank = Tank(line.rig, line.robot, settings_of(line), np.array(line.start), 7)
    coils: TankCoils = tank.coils
    height = tank.carrier.hull.float_height
    grid, table = _tabulate_plane(coils, line.rig, height)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-18e-3, 18e-3, (50, 2)), height + rng.uniform(-0.2e-3, 0.2e-3, 50)])
    true = compute_fields(points, coils.fields.rows, coils.fields.coefficients)
    for coil in range(coils.n_actuation):
        unit = np.eye(table.shape[2])[coil]
        found = np.array([compute_plane_field(*p, unit, grid, table) for p in points])
        assert np.abs(found[:, :3] - true[coil]).max() < 2e-3 * np.abs(true[coil]).max()
        slopes = []
        for step in 1e-4 * np.eye(3):  # dBx/dx, dBx/dy, dBx/dz by finite differences of the true field
            ahead, behind = (
                compute_fields(points + sign * step, coils.fields.rows, coils.fields.coefficients)[coil, :, 0]
                for sign in (1, -1)
            )
            slopes.append((ahead - behind) / 2e-4)
        assert np.abs(found[:, 3:6].T - slopes).max() < 1e-2 * np.abs(slopes).max()
