"""Device files: what is written is read back, and what does not belong is refused with its line."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from smolbot.config.device import DeviceConfig, DeviceUncertainty, load_device, write_device
from smolbot.errors import ConfigError, MissingFileError


@pytest.fixture
def written(tmp_path, along_device):
    config = DeviceConfig(
        "gradient",
        "tank",
        datetime.date(2026, 11, 22),
        along_device,
        DeviceUncertainty(0.003, 0.012, 0.3),
        0.0597,
        'the "new" one',
    )
    path = tmp_path / "device.toml"
    write_device(path, config)
    return path, config


def test_a_written_device_is_read_back_whole(written):
    path, config = written
    found = load_device(path, "gradient")
    for name in ("moment", "l0", "theta_max", "frequency", "damping"):
        assert getattr(found.device, name) == pytest.approx(getattr(config.device, name), rel=1e-9)
    assert np.array(found.device.moment_in_body) == pytest.approx(config.device.moment_in_body)
    assert found.device.damping_model == config.device.damping_model
    assert found.std.theta_max == pytest.approx(0.003)
    assert (found.std.frequency, found.std.damping) == pytest.approx((0.012, 0.3))
    assert (found.robot, found.rig, found.date, found.description) == ("gradient", "tank", config.date, 'the "new" one')
    assert found.height == pytest.approx(0.0597)


def test_another_robots_device_is_refused_where_it_names_its_own(written):
    path, _ = written
    with pytest.raises(ConfigError, match=r"device\.toml:2: robot: .*'gradient'; asked for is 'helix'"):
        load_device(path, "helix")


def test_every_fault_of_a_device_file_has_its_line(written):
    path, _ = written
    text = path.read_text().replace("l0_mm = ", "l0 = ").replace("frequency_hz = 103.5", "frequency_hz = -1.0")
    path.write_text(text)
    with pytest.raises(ConfigError) as fault:
        load_device(path)
    lines = str(fault.value).splitlines()
    assert len(lines) == 3  # unknown l0, missing l0_mm, negative frequency
    assert any("device.l0: unknown key" in line and "l0_mm" in line for line in lines)
    assert any("device.frequency_hz" in line for line in lines)
    with pytest.raises(MissingFileError):
        load_device(path.parent / "none.toml")


def test_a_direction_out_of_the_plane_of_swing_is_a_fault_of_the_file(written):
    path, _ = written
    path.write_text(path.read_text().replace("[0.0, 0.0, 1.0]", "[0, 1, 0]"))
    with pytest.raises(ConfigError, match=r"device\.toml:\d+: device.*plane of oscillation"):
        load_device(path)
