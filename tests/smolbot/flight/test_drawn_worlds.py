"""The share of drawn worlds in which a mission would end, and what would mend one that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.config.nominal_excitation import NominalExcitation
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError
from smolbot.flight.preview import drawn_worlds
from smolbot.flight.preview.drawn_worlds import MIN_SHARE, draw_perturbation, fly_chosen_worlds, fly_drawn_worlds
from smolbot.flight.preview.gradient import preview
from smolbot.flight.preview.pose_trust import find_pose_faults
from smolbot.flight.preview.remedies import change_mission
from smolbot.flight.preview.rollout import Rollout, RolloutParts
from tests.conftest import mission_of


@pytest.fixture(scope="module")
def parts():
    return RolloutParts.prepare(mission_of("line"))


def test_the_same_number_is_the_same_world_and_another_number_another():
    one, again, other = (draw_perturbation(mission_of("line"), number) for number in (3, 3, 4))
    np.testing.assert_array_equal(one.coil_gains, again.coil_gains)
    assert (one.drag, one.heading) == (again.drag, again.heading)
    assert one.drag != other.drag


def test_without_mismatch_every_world_obeys_the_files():
    drawn = draw_perturbation(mission_of("line", rig__tank__mismatch__scale="0.0"), 0)
    assert (drawn.drag, drawn.rotational_drag, drawn.moment) == (1.0, 1.0, 1.0)
    np.testing.assert_array_equal(drawn.coil_gains, 1.0)
    np.testing.assert_array_equal(drawn.pose_bias, 0.0)


def test_worlds_differ_as_far_as_the_rig_file_says():
    spread = {}
    for scale in ("1.0", "2.0"):
        mission = mission_of("line", rig__tank__mismatch__scale=scale)
        spread[scale] = np.std([draw_perturbation(mission, number).drag for number in range(40)])
    assert spread["2.0"] == pytest.approx(2.0 * spread["1.0"], rel=0.1)


def test_a_mission_with_room_to_spare_is_flown_in_few_worlds_and_is_a_go(parts):
    found = fly_drawn_worlds(parts)
    assert found.flown == found.ended == drawn_worlds.FIRST_WORLDS
    assert str(found) == "6 of 6 in time"
    assert np.ptp(found.durations) > 1.0


@pytest.fixture(scope="module")
def tight():
    """A mission whose limit is as long as it takes without mismatch: no go, though its own rollout ends."""
    mission = mission_of("line")
    took = Rollout(RolloutParts.prepare(mission)).fly()
    return change_mission(mission, {"stop.max_duration_s": took.duration - took.learned_at})


@pytest.fixture(scope="module")
def seen(tight):
    return preview(tight)


def test_a_mission_that_ends_just_in_time_is_no_go_with_its_share_and_what_would_mend_it(seen):
    assert not seen.go
    assert seen.worlds.share < MIN_SHARE
    assert f"{seen.worlds.ended} of {seen.worlds.flown} drawn worlds" in seen.reasons[0]
    assert "max_duration_s" in seen.reasons[0]
    assert seen.remedy.startswith("--set stop.max_duration_s=")


def test_a_remedy_helps_in_the_worlds_that_failed_without_it(tight, seen):
    longer = change_mission(tight, {"stop.max_duration_s": float(seen.remedy.split("=")[-1])})
    found = fly_chosen_worlds(RolloutParts.prepare(longer), seen.worlds.failed[:3])
    assert found.ended == found.flown == 3


def test_coils_that_come_close_to_their_limit_leave_a_doubt_that_more_worlds_are_flown_for(parts, monkeypatch):
    hottest = max(Rollout(parts).fly().peaks)
    ambient = parts.mission.rig.sections.safety.ambient_c
    room = (hottest - ambient) / drawn_worlds.ROOM_TO_SPARE
    safety = {"rig.safety.coils.max_temperature_c": ambient + 0.98 * room}
    close = change_mission(parts.mission, safety)
    monkeypatch.setattr(drawn_worlds, "WORLDS", drawn_worlds.FIRST_WORLDS + 1)
    found = fly_drawn_worlds(replace(parts, mission=close))
    assert found.flown == drawn_worlds.FIRST_WORLDS + 1


def test_errors_that_break_the_verdict_fail_a_world_too(parts):
    strict = change_mission(parts.mission, {"verdict.mean_localization_mm": 0.2})
    found = fly_chosen_worlds(replace(parts, mission=strict), [0])
    assert found.ended == 0
    assert "above mean_localization_mm = 0.2" in found.reasons[0]


def test_a_changed_mission_shares_what_is_not_changed():
    mission = mission_of("line")
    changed = change_mission(
        mission, {"rig.limits.max_current_a": 4.0, "controller.gains.speed_mm_s": 2.0, "stop.max_duration_s": 9.0}
    )
    assert changed.rig.limits.max_current == 4.0
    assert changed.gains["speed_mm_s"] == 2.0
    assert changed.base.stop.max_duration_s == changed.sections.stop.max_duration_s == 9.0
    assert mission.rig.limits.max_current == 8.0
    assert "speed_mm_s" not in mission.gains
    assert changed.setup().table is mission.setup().table


def test_a_device_that_the_excitation_hardly_moves_is_no_go(parts):
    errors = replace(parts.errors, amplitudes=np.full(len(parts.errors.amplitudes), 1e-3))
    assert not find_pose_faults(parts.mission, parts.errors)
    (reason,) = find_pose_faults(parts.mission, errors)
    assert "no pose would be trusted near" in reason
    assert "0.057° of 17.8°" in reason


def test_a_fault_of_the_mismatch_section_names_its_place():
    rig = load_rig("bench", {"tank.mismatch.drag_percent": "-5.0"})
    with pytest.raises(ConfigError, match=r"tank\.mismatch\.drag_percent"):
        _ = rig.mismatch


def test_the_field_of_a_bobbin_close_under_the_container_is_known():
    low = {"container.floor_z_mm": "35.0", "container.surface_z_mm": "53.0"}
    excitation = NominalExcitation(load_rig("tank", low))
    at = np.array([0.005, -0.003, 0.053])
    direct = [coil.field(at[None, :])[0] for coil in load_rig("tank").flat_coils()]
    np.testing.assert_allclose(excitation.compute_field(at), direct, rtol=1e-3, atol=1e-9)
