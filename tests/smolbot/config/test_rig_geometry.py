"""A rig in which nothing can work is refused when its file is read: which part, where, and how far to move it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lookup_tables import RoundCoil
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError

SENSORS = load_rig("tank").sections.sensors.positions_mm


def move_sensor(number, place):
    """The setting by which one sensor of the tank stands elsewhere."""
    places = [list(p) for p in SENSORS]
    places[number] = list(place)
    return {"sensors.positions_mm": json.dumps(places)}


def read(settings, rig="tank"):
    with pytest.raises(ConfigError) as error:
        load_rig(rig, settings)
    return str(error.value)


@pytest.mark.parametrize("rig", ["bench", "bench_gel", "brain", "gel", "gel_blocked", "kidney", "tank", "twin"])
def test_shipped_rigs_have_everything_where_it_can_be(rig):
    assert load_rig(rig).name


@pytest.mark.parametrize("size", [84.0, 60.0, 44.0, 10.0])
def test_a_container_between_the_coils_touches_none(size):
    assert load_rig("tank", {"container.size_mm": f"[{size}, {size}]"}).container.size_mm == (size, size)


@pytest.mark.parametrize("depth", [0.1, 1.0, 18.0])
def test_a_container_that_reaches_into_coils_is_refused_with_coil_wall_and_depth(depth):
    message = read({"container.size_mm": f"[{84.0 + 2.0 * depth}, 44.0]"})
    for coil, wall, place in (("+x", "+x", 42.0 + depth), ("-x", "-x", -42.0 - depth)):
        assert f"coil '{coil}' reaches {depth:.1f} mm into the container, through its {wall} wall" in message
        assert f"x = {place:g} mm" in message
    assert "'+y'" not in message


def test_an_oblique_coil_is_found_where_its_rim_passes_the_wall(tmp_path):
    turned = load_rig("tank").document.text.replace("axis = [1, 0, 0]\ninner", "axis = [1, 1, 0]\ninner", 1)
    path = tmp_path / "rig.toml"
    path.write_text(turned.replace("size_mm = [44, 44]", "size_mm = [70, 44]"))
    rim = 52.0 - 35.0 * np.sqrt(0.5) - 10.0 * np.sqrt(0.5)  # mm: the innermost point of the winding
    assert f"coil '+x' reaches {35.0 - rim:.1f} mm into the container" in read({}, str(path))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"container.floor_z_mm": "32.0"}, "excitation coil 'x' reaches 2.0 mm into the container, through its floor"),
        ({"container.center_mm": "[52, 25]", "container.size_mm": "[4, 4]"}, "coil '+x'"),
        (move_sensor(0, (0, 0, 55)), "sensor 0 at (0.0, 0.0, 55.0) mm lies in the container, where the robot swims"),
        (move_sensor(3, (0, 0, 29)), "sensor 3 at (0.0, 0.0, 29.0) mm lies in excitation coil 'x'"),
        (move_sensor(3, (52, 25, 60)), "sensor 3 at (52.0, 25.0, 60.0) mm lies in coil '+x'"),
        (move_sensor(1, SENSORS[0]), "hears what sensor 0 hears: same place, same axis"),
        (move_sensor(1, (-75.0, -41.2, 0.4)), "Two sensors of one axis need 1 mm or more"),
    ],
)
def test_what_stands_where_it_cannot_is_named(settings, words):
    assert words in read(settings)


def test_a_sensor_may_stand_in_the_bore_of_a_coil_and_three_axes_at_one_place():
    assert load_rig("tank", move_sensor(0, (52, 0, 60)))
    assert load_rig("tank", move_sensor(6, SENSORS[0]))  # along x, the other along z


@pytest.mark.parametrize(("axis", "words"), [("[1, 0, 0]", "have the same axis"), ("[0, 0, 1]", "has a vertical axis")])
def test_excitation_coils_drive_along_two_level_axes(tmp_path, axis, words):
    path = tmp_path / "rig.toml"
    path.write_text(load_rig("tank").document.text.replace("axis = [0, 1, 0]\nlength", f"axis = {axis}\nlength"))
    assert words in read({}, str(path))


def test_a_magnet_that_strikes_the_container_is_refused():
    message = read({"magnet.center_mm": "[0, 0, 90.0]"}, "gel")
    assert "the magnet is 30.0 mm from the container, and its edges turn on a radius of 35.9 mm" in message


def test_the_field_on_a_current_loop_is_finite():
    coil = RoundCoil("+x", np.array([0.052, 0, 0]), np.array([1.0, 0, 0]), 0.015, 0.035, 0.02, 200)
    on, beside = coil.field(np.array([[0.052, 0.025, 0.0], [0.052, 0.0, -0.025]]))  # the middle loop of 5 x 5
    assert on[0] == pytest.approx(beside[0], rel=1e-12)
    assert 1e-4 < on[0] < 1e-2  # T per A: as within the winding
