"""Errors carry what a program may react to, through a pickle too; what people read stays as it was."""

from __future__ import annotations

import inspect
import pickle

import pytest

import smolbot
from controllers import UnreachableForceError
from lookup_tables import OutsideTableError, RoundCoil, TableError, build
from smolbot import errors
from smolbot.config import plugins
from smolbot.core.limits import Limits
from smolbot.flight.safety.supervisor import Safety, make_limits_only_safety

LIMITS = Limits(("+x", "-y"), max_current=8.0, max_actuation=0.2, min_ring_down=0.02, max_listen=1.0)
OURS = [c for c in vars(errors).values() if inspect.isclass(c) and issubclass(c, errors.SmolbotError)]
VALUES = {"limit": 8.0, "value": 9.0, "unit": "A", "channel": "+x", "device": "card", "name": "lime", "group": "rigs",
          "known": ("line",), "signal_to_noise": 3.0, "needed": 20.0, "most": 1e-6, "point": (0.0, 0.0, 1.0),
          "low": (0.0, 0.0, 0.0), "high": (0.1, 0.1, 0.1)}  # fmt: skip


@pytest.mark.parametrize("kind", [*OURS, UnreachableForceError, OutsideTableError, TableError])
def test_message_and_fields_survive_a_pickle(kind):
    named = [p.name for p in inspect.signature(kind.__init__).parameters.values() if p.kind is p.KEYWORD_ONLY]
    fields = {name: VALUES[name] for name in named}
    again = pickle.loads(pickle.dumps(kind("what people read", **fields)))
    assert type(again) is kind
    assert str(again) == "what people read"
    assert {name: getattr(again, name) for name in named} == fields


@pytest.mark.parametrize("kind", OURS)
def test_every_error_can_be_raised_with_its_message_alone(kind):
    with pytest.raises(kind, match="why"):
        raise kind("why")


@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        ((smolbot.Actuate((9.0, 0.0), 0.03),), (8.0, 9.0, "A", "+x")),
        ((smolbot.Actuate((0.0, -1.0), 0.03),), (0.0, -1.0, "A", "-y")),
        ((smolbot.Actuate((0.0, 0.0), 0.3),), (0.2, 0.3, "s", "")),
        ((smolbot.Excite((11.0, 0.0), 100.0, 5),), (10.0, 11.0, "A", "excitation x")),
        ((smolbot.Listen(1000, 100.0),), (1.0, 5.0, "s", "")),
        ((smolbot.MoveMagnet("near", 1.0),), (None, None, "", "")),
    ],
)
def test_a_broken_limit_is_told_by_its_fields_by_rig_and_safety_alike(windows, expected):
    shot = smolbot.Shot(windows)
    with pytest.raises(smolbot.InterlockError) as refused:
        LIMITS.check(shot)
    safety: Safety = make_limits_only_safety(LIMITS, 10)
    with pytest.raises(errors.SafetyError) as stopped:
        safety.check_shot(shot, 0.0, None)
    for error in (refused.value, stopped.value):
        assert (error.limit, error.value, error.unit, error.channel) == expected


def test_every_fault_of_a_file_has_file_line_and_key(tmp_path):
    path = tmp_path / "mine.toml"
    text = smolbot.load_mission("line").document.text
    path.write_text(text.replace("tolerance_mm", "tolerence_mm"))
    with pytest.raises(smolbot.ConfigError) as wrong:
        smolbot.load_mission(str(path), settings={"stop.max_duration_s": "-1", "rig.sensors.adc_bits": "'many'"})
    found = {fault.key: fault for fault in wrong.value.faults}
    line = next(i for i, row in enumerate(path.read_text().splitlines(), 1) if "tolerence_mm" in row)
    misspelt = found["controller.tolerence_mm"]
    assert (misspelt.file, misspelt.line) == (str(path), line)
    assert "unknown key" in misspelt.fault
    assert found["stop.max_duration_s"].file == ""
    assert "rig.sensors.adc_bits" in found
    assert (wrong.value.file, wrong.value.line, wrong.value.key) == (
        wrong.value.faults[0].file, wrong.value.faults[0].line, wrong.value.faults[0].key,
    )  # fmt: skip


def test_names_that_are_not_there_say_which_and_what_is():
    with pytest.raises(errors.MissingFileError) as missing:
        smolbot.load_mission("lime")
    assert missing.value.name == "lime"
    assert "line" in missing.value.known
    with pytest.raises(errors.PluginError) as unknown:
        plugins.load_plugin("controllers", "lasso")
    assert (unknown.value.group, unknown.value.name) == ("controllers", "lasso")


def test_a_point_outside_a_table_is_told_with_what_it_covers():
    import numpy as np

    coil = RoundCoil("+x", np.array([0.05, 0, 0]), np.array([1.0, 0, 0]), 0.01, 0.02, 0.01, 100)
    axis = 1e-3 * np.arange(-3.0, 4.0)
    with pytest.raises(OutsideTableError) as outside:
        build([coil], axis, axis, axis).field(np.array([[0.0, 0.0, 0.1]]))
    assert outside.value.point == (0.0, 0.0, 0.1)
    assert outside.value.low == pytest.approx((-3e-3,) * 3)
    assert outside.value.high == pytest.approx((3e-3,) * 3)
