"""`smolbot check` on tanks: a healthy one passes, and what is wrong with a doctored one is named."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from sim.tank.rig import TankRig
from sim.tank.world import TankWorld
from smolbot.core.coil_probe import Probe
from smolbot.core.rig import CheckItem
from smolbot.core.sensing import Recording
from smolbot.errors import RigError
from smolbot.ui.cli import app as command_line

SHORT = ["--quiet-s", "3"]


@pytest.fixture
def smolbot(monkeypatch, capsys):
    """``code, out, err = smolbot("check", "tank")``."""

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["smolbot", *arguments])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return int(ended.value.code or 0), out, err

    return call


@pytest.fixture
def doctored(monkeypatch):
    """Tanks that are opened from now on pass through a doctor's hands."""

    def doctor(operate: Callable[[TankRig], object]) -> None:
        healthy = TankWorld.open
        monkeypatch.setattr(TankWorld, "open", staticmethod(lambda *a, **k: operate(healthy(*a, **k))))

    return doctor


class Patient:
    """A tank of which the recordings go through `change` before anybody sees them."""

    def __init__(self, tank: TankRig, change: Callable[[np.ndarray], np.ndarray]) -> None:
        self._tank, self._change = tank, change

    def __getattr__(self, name: str):
        return getattr(self._tank, name)

    def play(self, shot):
        heard = self._tank.play(shot)
        return None if heard is None else self._changed(heard)

    def probe(self, coil: str, current: float) -> Probe:
        probe = self._tank.probe(coil, current)
        return replace(probe, recording=self._changed(probe.recording))

    def _changed(self, heard: Recording) -> Recording:
        return replace(heard, field=self._change(np.array(heard.field)))


def faults(out: str) -> list[str]:
    return json.loads(out)["faults"]


@pytest.mark.parametrize("rig", ["tank", "gel", "kidney", "brain"])
def test_every_shipped_simulated_rig_passes(smolbot, rig):
    code, out, err = smolbot("check", rig, "--json", *SHORT)
    found = json.loads(out)
    assert (code, found["faults"], found["ok"]) == (0, [], True)
    assert len(found["sensors"]) == 10
    assert {c["coil"] for c in found["coils"]} >= {"excitation x", "excitation y"}
    assert "passed" in err, "the table goes to standard error where standard output is one JSON object"


def test_the_figures_are_those_of_the_rig_file(smolbot):
    _, out, _ = smolbot("check", "tank", "--json")
    found = json.loads(out)
    floors = np.array([s["noise_floor_pt_per_rthz"] for s in found["sensors"]])
    slow = np.array([s["noise_1hz_pt_per_rthz"] for s in found["sensors"]])
    assert floors == pytest.approx(6.0, rel=0.35)  # noise_percent is 10, one standard deviation
    assert np.ptp(floors) < 0.1 * floors.mean()  # which is drawn once for all sensors
    assert np.median(slow) == pytest.approx(20.0, rel=0.4)
    assert found["mains_hz"] == pytest.approx(50.0, abs=0.05)
    for coil in found["coils"]:
        assert coil["gain"] == pytest.approx(1.0, abs=0.1)
        assert coil["close_ms"] == pytest.approx(0.0, abs=0.05)  # a tank has no relays
        assert coil["open_ms"] == pytest.approx(0.0, abs=0.05)


def test_a_reversed_coil_is_found(smolbot, doctored):
    def reverse(tank: TankRig) -> TankRig:
        tank._tank.coils.coupling[2] *= -1
        return tank

    doctored(reverse)
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert (code, faults(out)) == (1, ["coil +y: reversed"])


def test_swapped_coils_are_found(smolbot, doctored):
    def swap(tank: TankRig) -> TankRig:
        tank._tank.coils.coupling[[0, 3]] = tank._tank.coils.coupling[[3, 0]]
        return tank

    doctored(swap)
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert code == 1
    assert faults(out) == ["coil +x: this is the field of -y", "coil -y: this is the field of +x"]


def change_channel(sensor: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[TankRig], Patient]:
    def changed(field: np.ndarray) -> np.ndarray:
        field[sensor] = change(field[sensor])
        return field

    return lambda tank: Patient(tank, changed)


def test_a_dead_sensor_is_found_and_spoils_nothing_else(smolbot, doctored):
    doctored(change_channel(4, np.zeros_like))
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert (code, faults(out)) == (1, ["sensor 4: dead: every sample is the same"])


def test_a_sensor_with_twice_the_noise_is_found(smolbot, doctored):
    rng = np.random.default_rng(1)
    extra = np.sqrt(3.0) * 6e-12 * np.sqrt(25_000.0)  # white noise of sqrt(3) times the floor on top of it
    doctored(change_channel(7, lambda wave: wave + extra * rng.standard_normal(len(wave))))
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert code == 1
    (fault,) = faults(out)
    assert fault.startswith("sensor 7: noise floor 1")
    assert "times what is expected" in fault


def test_a_sensor_that_stands_far_off_zero_is_found(smolbot, doctored):
    doctored(change_channel(0, lambda wave: wave + 6.5e-6))
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert code == 1
    (fault,) = faults(out)
    assert fault.startswith("sensor 0: offset takes 6")


def test_a_sensor_that_is_wired_the_wrong_way_round_is_found(smolbot, doctored):
    doctored(change_channel(9, np.negative))
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert (code, faults(out)) == (1, ["sensor 9: reversed"])


class Late(Patient):
    """A tank with relays: one opens late, against limits of its own."""

    def probe(self, coil: str, current: float) -> Probe:
        probe = self._tank.probe(coil, current)
        late = round(4e-3 * probe.recording.sample_rate) if coil == "-x" else 0
        field = np.array(probe.recording.field)
        on = round(probe.on * probe.recording.sample_rate)
        field[:, on + late :] = field[:, on : field.shape[1] - late]
        field[:, on : on + late] = field[:, on - late : on]
        return Probe(replace(probe.recording, field=field), probe.on, probe.off, 1e-3, 5e-3)


def test_a_slow_relay_is_found(smolbot, doctored):
    doctored(lambda tank: Late(tank, lambda field: field))
    code, out, _ = smolbot("check", "tank", "--json", *SHORT)
    assert (code, faults(out)) == (1, ["coil -x: its field comes 4.0 ms late, limit 1.5 ms"])
    coil = next(c for c in json.loads(out)["coils"] if c["coil"] == "-x")
    assert coil["open_ms"] == pytest.approx(4.0, abs=0.05)


class Wired(Patient):
    """A tank with a device that reads back wrongly."""

    def checks(self) -> Iterator[CheckItem]:
        yield CheckItem("card Dev1", "product", "PCIe-6363", True, "PCIe-6363")
        yield CheckItem("card Dev1", "relays' contacts", "one is closed", False, "all open")


def test_a_device_that_reads_back_wrongly_fails_the_check_and_stands_in_the_table(smolbot, doctored):
    doctored(lambda tank: Wired(tank, lambda field: field))
    code, out, _ = smolbot("check", "tank", *SHORT)
    assert code == 1
    assert "relays' contacts" in out
    assert "card Dev1: relays' contacts is one is closed, not all open" in out


def test_a_rig_that_cannot_hear_its_own_coils_is_checked_for_the_rest(smolbot, doctored):
    class Deaf:
        def __init__(self, tank: TankRig) -> None:
            self.sensors, self.limits, self.witness = tank.sensors, tank.limits, tank.witness
            self.play, self.now, self.close, self.stop = tank.play, tank.now, tank.close, tank.stop
            self.excitation_field = tank.excitation_field

    doctored(Deaf)
    code, out, _ = smolbot("check", "tank", *SHORT)
    assert code == 0
    assert "coils and relays were not checked" in out


def test_a_world_that_fails_under_it_ends_with_3(smolbot, doctored):
    def fail(tank: TankRig) -> TankRig:
        def gone(*_: object) -> None:
            raise RigError("Dev1 is gone; every output is at zero.")

        tank.probe = gone
        return tank

    doctored(fail)
    code, out, err = smolbot("check", "tank", *SHORT)
    assert (code, out) == (3, "")
    assert "Dev1 is gone" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "No rig is named 'nowhere'"),
        (["tank", "--robot", "nobody"], "No robot is named 'nobody'"),
        (["tank", "--quiet-s", "0.5"], "at least 1 s; got 0.5 s"),
    ],
)
def test_bad_input_ends_with_2_and_one_message(smolbot, arguments, message):
    code, out, err = smolbot("check", *arguments)
    assert (code, out) == (2, "")
    assert message in err


def test_what_only_a_person_can_verify_follows_the_rig(smolbot):
    _, gel, _ = smolbot("check", "gel", *SHORT)
    _, tank, _ = smolbot("check", "tank", *SHORT)
    assert "Magnet (" in gel
    assert "hand compass" not in gel, "no actuation coils there"
    assert "hand compass" in tank
    assert "Magnet (" not in tank


def test_a_probe_leaves_the_tank_as_an_equal_shot_does():
    """It is refused where a shot would be, and hears the coil at the field that the table of couplings says."""
    from smolbot.config.rig import load_rig
    from smolbot.config.robot import load_robot
    from smolbot.errors import InputError, InterlockError

    with TankWorld.open(load_rig("tank"), load_robot("gradient"), (0.0, 0.0), seed=5) as tank:
        with pytest.raises(InterlockError, match="'-x' current must lie within 0 to 8 A; got 9.00 A"):
            tank.probe("-x", 9.0)
        with pytest.raises(InputError, match=r"No coil 'z' can be probed; coils are \+x"):
            tank.probe("z", 0.1)
        assert tank.now() == 0.0
        probe = tank.probe("excitation y", 0.01)
        rate = probe.recording.sample_rate
        settled = np.asarray(probe.recording.field)[:, round((probe.off - 0.02) * rate) : round(probe.off * rate)]
        before = np.asarray(probe.recording.field)[:, : round(probe.on * rate)]
        rise = settled.mean(axis=1) - before.mean(axis=1)
        coupling = tank._tank.coils.coupling[5]
        np.testing.assert_allclose(rise, 0.01 * coupling, atol=2e-9)  # the robot turns a little meanwhile
        assert tank.now() > 0.1
