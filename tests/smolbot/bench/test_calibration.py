"""A device is calibrated in the tank from what the sensors hear; the truth is asked for in the checks only."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from sim.tank.world import TankWorld
from smolbot.bench.calibration.device import (
    Calibration,
    CalibrationPlan,
    DrivePoint,
    SweepPoint,
    calibrate,
    compute_weighted_mean,
)
from smolbot.config.device import DeviceUncertainty, load_device
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.errors import InputError, SignalLostError
from smolbot.functions.targets import expected_hum, find_target
from smolbot.ui.cli.app import main

QUICK = CalibrationPlan(sweep_points=3, repeats=2)


class Blind:
    """A tank without its witness, whose operator alone knows the height."""

    def __init__(self, seed, **settings):
        config = load_rig("tank", {key.replace("__", "."): value for key, value in settings.items()})
        self.rig = TankWorld.open(config, load_robot("gradient"), (0.0, 0.0), seed)
        self.truth = self.rig.provenance()["truth"]
        self.height = float(self.rig.witness.truth(0.0).position[2])
        self.rig.witness = None
        self.hum = expected_hum(config)


def check(found, truth, believed):
    """Frequency within 0.03 Hz, damping and stop within 3 % of the truth.

    What is left of the earth's field, 3 µT, stiffens or softens the cantilever: f m B / (2 k) = 0.023 Hz, and stays.
    The amplitude is heard as moment times angle: the angle's true share is that of their product.
    """
    assert found.stops_reached
    assert found.device.damping_model == "exponential"
    assert found.evidence > 100.0
    assert found.device.frequency == pytest.approx(believed.frequency * truth["frequency"], abs=0.03)
    assert found.device.damping == pytest.approx(believed.damping * truth["damping"], rel=0.03)
    assert found.device.theta_max == pytest.approx(believed.theta_max * truth["theta_max"], rel=0.03)
    product = truth["theta_max"] * truth["moment"]
    assert found.device.theta_max == pytest.approx(believed.theta_max * product, rel=0.03)


def test_a_device_in_the_tank_is_calibrated_from_its_signal_alone():
    tank, believed = Blind(7), load_robot("gradient").device
    found = calibrate(tank.rig, believed, tank.height, plan=QUICK, hum=tank.hum)
    check(found, tank.truth, believed)
    assert 0 < found.std.frequency < 0.02
    assert 0 < found.std.damping < 0.5
    assert 0.01 < found.std.theta_max / found.device.theta_max < 0.03  # the height's 0.2 mm alone make 1 %


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_other_tanks_are_calibrated_as_well(seed):
    tank, believed = Blind(seed), load_robot("gradient").device
    check(calibrate(tank.rig, believed, tank.height, hum=tank.hum), tank.truth, believed)


@pytest.mark.slow
def test_a_belief_that_is_far_off_does_not_matter():
    tank, true = Blind(7), load_robot("gradient").device
    believed = replace(true, frequency=true.frequency + 3.0, damping=15.0, theta_max=0.8 * true.theta_max)
    found = calibrate(tank.rig, believed, tank.height, plan=QUICK, hum=tank.hum)
    check(found, tank.truth, true)


def test_a_drive_too_weak_to_be_heard_is_said_so():
    tank, believed = Blind(3), load_robot("gradient").device
    with pytest.raises(SignalLostError, match=r"signal to noise .* with up to 0\.001 A at 103\.5 Hz"):
        calibrate(tank.rig, believed, tank.height, plan=replace(QUICK, max_current=1e-3), hum=tank.hum)


def test_plans_and_heights_of_no_use_are_refused():
    tank = Blind(3)
    with pytest.raises(InputError, match="known z of the device above the sensors, in m; got 60"):
        calibrate(tank.rig, load_robot("gradient").device, 60.0)
    with pytest.raises(InputError, match="repeats must be at least 2; got 1"):
        CalibrationPlan(repeats=1)


def test_scatter_beyond_what_is_claimed_widens_the_mean():
    claimed = compute_weighted_mean([(1.0, 0.1), (1.0, 0.1), (1.0, 0.1)])
    scattered = compute_weighted_mean([(0.0, 0.1), (1.0, 0.1), (2.0, 0.1)])
    assert claimed == pytest.approx((1.0, 0.1 / np.sqrt(3)))
    assert scattered == pytest.approx((1.0, 1.0 / np.sqrt(3)))


@pytest.mark.parametrize(("reached", "code"), [(True, 0), (False, 1)])
def test_the_command_writes_a_device_file_that_names_its_robot(tmp_path, monkeypatch, capsys, reached, code):
    def told_beforehand(rig, device, height, **_):
        better = replace(device, frequency=103.61, damping=32.5, theta_max=0.32)
        sweep = (SweepPoint(103.0, 103.61, 0.01, 1e-7), SweepPoint(104.0, 103.61, 0.01, 2e-7))
        drives = (DrivePoint(1.0, 0.1, 0.001), DrivePoint(3.0, 0.32, 0.001))
        return Calibration(
            better, DeviceUncertainty(0.003, 0.01, 0.2), device, height, sweep, drives, 500.0, reached, 9
        )

    monkeypatch.setattr("smolbot.functions.calibrate.calibrate_device", told_beforehand)
    out = tmp_path / "device.toml"
    monkeypatch.setattr(sys, "argv", ["smolbot", "calibrate", "tank", "--z-mm", "59.7", "--out", str(out), "--json"])
    with pytest.raises(SystemExit) as left:
        main()
    printed = capsys.readouterr()
    told = json.loads(printed.out)
    assert left.value.code == code
    assert ("stops were not reached" in printed.err) is not reached
    found = load_device(out, "gradient")
    assert found.device.frequency == pytest.approx(103.61)
    assert found.std.damping == pytest.approx(0.2)
    assert found.height == pytest.approx(0.0597)
    assert told["theta_max_deg"]["believed"] == pytest.approx(17.8)
    assert told["frequency_hz"] == {"value": 103.61, "std": 0.01, "believed": 103.5}


def test_a_height_outside_the_container_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["smolbot", "calibrate", "tank", "--z-mm", "0.06", "--out", str(tmp_path / "d")])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert "height (--z-mm) must lie within the container of rig 'tank', 45 to 80 mm" in capsys.readouterr().err


def test_rigs_and_missions_are_told_apart():
    rig, robot, start = find_target("tank", None)
    assert (rig.name, robot.name, start) == ("tank", "gradient", (0.0, 0.0))
    rig, _, start = find_target("line", None)
    assert rig.name == "tank"
    assert start != (0.0, 0.0)
    with pytest.raises(InputError, match=r"No rig or mission is named 'tnak'. Rigs: .*tank"):
        find_target("tnak", None)
