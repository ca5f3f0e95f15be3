"""Signals of a generator that shares no code with the forward model: `python -m tests.golden.foreign NAME` made them.

The swinging magnet is magpylib's cylinder, its motion an integrated pendulum with cubic stiffness, its path into the
sensors scipy's Butterworth filter, its noise scaled pink noise and mains. Nothing of smolbot takes part in the making.
"""

from __future__ import annotations

import lzma
import sys
from io import BytesIO
from typing import Any

import numpy as np

from tests.golden.answers import GoldenFileError
from tests.golden.corpus import SIGNALS, add_windows

NAME = "foreign"
RATE = 50_000.0
STEP = 0.305e-9
"""Tesla for each count of the stored samples."""

MOMENT, L0, SWING, FREQUENCY = 0.89e-3, 1.5e-3, np.radians(17.8), 103.5
KINDS = ((2, 31.7, "z"), (2, 1.1, "z"), (2, 1.1, "x"), (6, 31.7, "z"), (6, 1.1, "x"), (20, 1.1, "x"))
"""Half-periods, damping in 1/s, and the body axis of the moment; three poses of each but the last."""


def make(seed: int = 20) -> dict[str, Any]:
    """Quiet noise and windows, with the true poses; positions are those of the rotation centre."""
    rng = np.random.default_rng(seed)
    places = np.array(
        [(x, y, 0.0) for y in (-0.055, 0.055) for x in (-0.06, -0.02, 0.02, 0.06)] + [(-0.06, 0, 0), (0.06, 0, 0)]
    )
    axes = np.array(
        [(0.0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 0)]
    )
    mains = rng.uniform(0, 2 * np.pi, 4)
    out: dict[str, Any] = {"places": places, "axes": axes, "step": STEP, "rate": RATE}
    out["quiet"] = _counts(_noise(rng, places, axes, mains, 0.0, int(0.8 * RATE)))
    clock = 1.0
    for half_periods, damping, along in KINDS:
        for again in range(3 if half_periods < 20 else 1):
            position = np.array([*rng.uniform(-0.008, 0.008, 2), rng.uniform(0.06, 0.08)])
            turn = _turn(rng, upright=along == "z")
            since = 0.02
            n = round(half_periods / (2 * FREQUENCY) * RATE)
            signal = _signal(places, axes, position, turn, damping, along, rng.uniform(0, 0.2), since, n)
            heard = signal + _noise(rng, places, axes, mains, clock, n) + rng.normal(0, 50e-9, (10, 1))
            key = f"w{half_periods}_{damping}_{along}_{again}"
            out[f"{key}_heard"], out[f"{key}_clock"] = _counts(heard), clock
            out[f"{key}_position"], out[f"{key}_turn"] = position, turn
            clock += 0.5
    return out


def _turn(rng: np.random.Generator, *, upright: bool) -> Any:
    """Rotation matrix, body to world: the moment near the horizontal, so that horizontal coils can drive it."""
    from scipy.spatial.transform import Rotation

    first = Rotation.from_euler("y", 90 + rng.uniform(-15, 15) if upright else rng.uniform(-15, 15), degrees=True)
    return (Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True) * first).as_matrix()


def _signal(
    places: Any, axes: Any, position: Any, turn: Any, damping: float, along: str, lead: float, since: float, n: int
) -> Any:
    """What ideal sensors hear of a magnet on a cantilever that was let go `since` s before."""
    import magpylib
    from scipy.integrate import solve_ivp
    from scipy.signal import butter, lfilter
    from scipy.spatial.transform import Rotation

    omega, before = 2 * np.pi * FREQUENCY, 0.02
    grid = np.arange(-round(before * RATE), round(since * RATE) + n) / RATE

    def slope(t: float, s: Any) -> Any:  # a stiffness that rises a little with the swing
        return [s[1], -2 * damping * s[1] - (omega**2 + damping**2) * s[0] * (1 + 1e-4 * s[0] ** 2)]

    let_go = 0.8 * SWING * np.exp(damping * before)
    start = [let_go * np.cos(lead), -let_go * omega * np.sin(lead)]
    angle = solve_ivp(slope, (grid[0], grid[-1]), start, t_eval=grid, rtol=1e-10, atol=1e-13, max_step=2e-4).y[0]
    size = 1e-3  # of the cylinder, across and along
    strength = MOMENT / (np.pi / 4 * size**3)
    aside = Rotation.from_rotvec(angle[:, None] * np.array([0.0, 1, 0]))
    rest = Rotation.identity() if along == "z" else Rotation.from_euler("y", 90, degrees=True)
    world = Rotation.from_matrix(turn)
    magnet = magpylib.magnet.Cylinder(magnetization=(0, 0, strength), dimension=(size, size))
    magnet.position = position + world.apply(aside.apply((0, 0, L0)))
    magnet.orientation = world * aside * rest
    field = np.einsum("tnk,nk->nt", magnet.getB(places), axes)
    b, a = butter(1, 1000.0, fs=RATE)
    still = field[:, :1]
    return (lfilter(b, a, field - still) + still)[:, -n:]


def _noise(rng: np.random.Generator, places: Any, axes: Any, mains: Any, clock: float, n: int) -> Any:
    """Mains with harmonics, smooth in space, a common drift, and pink noise over a floor of 6 pT/sqrt(Hz)."""
    t = clock + np.arange(n) / RATE
    common = np.zeros((3, n))
    for (frequency, size), phase in zip(((50, 6e-9), (100, 0.4e-9), (150, 0.8e-9), (250, 0.3e-9)), mains, strict=True):
        direction = np.array([0.6, 0.3, 0.75]) + 0.2 * np.cos(phase + np.arange(3))
        common += size * direction[:, None] * np.sin(2 * np.pi * frequency * t + phase)
    gradient = 1.0 + 0.8 * places[:, 0] - 0.5 * places[:, 1]
    frequencies = np.fft.rfftfreq(n, 1 / RATE)[1:]
    density = np.sqrt((20e-12 / np.sqrt(np.maximum(frequencies, 0.5))) ** 2 + 6e-12**2)
    sizes = density * np.sqrt(n * RATE) / 2
    lines = (rng.normal(size=(10, len(sizes))) + 1j * rng.normal(size=(10, len(sizes)))) * sizes
    own = np.fft.irfft(np.hstack([np.zeros((10, 1)), lines]), n)
    return gradient[:, None] * (axes @ common) + own


def _counts(field: Any) -> Any:
    return np.clip(np.rint(field / STEP), -32768, 32767).astype(np.int16)


def read() -> dict[str, Any]:
    """The stored signals.

    Raises
    ------
    GoldenFileError
        If they are missing or torn.
    """
    path = SIGNALS / f"{NAME}.npz.xz"
    try:
        with np.load(BytesIO(lzma.decompress(path.read_bytes()))) as found:
            return dict(found)
    except (OSError, lzma.LZMAError, EOFError, ValueError) as error:
        raise GoldenFileError(f"{path}: cannot be read: {error}; take it from version control again.") from error


def keys(signals: dict[str, Any]) -> list[str]:
    """Of the windows, in the order in which they were heard."""
    return [name.removesuffix("_heard") for name in signals if name.endswith("_heard")]


def locate_all(estimator: str) -> dict[str, Any]:
    """Every window located from nothing, and from a pose 2 mm and 5 degrees away."""
    from smolbot.core.blas_threads import limit_to_one_thread
    from smolbot.core.pose import Pose
    from smolbot.core.rotations import multiply_quaternions, quaternion_from_matrix, quaternion_from_rotation_vector
    from smolbot.core.sensing import Recording, SensorArray
    from smolbot.localization.localizer import Localizer
    from smolbot.localization.noise.model import NoiseModel

    signals = read()
    sensors = SensorArray(signals["places"], signals["axes"], bandwidth=1000.0)
    step, rate = float(signals["step"]), float(signals["rate"])
    with limit_to_one_thread():
        noise = NoiseModel.learn([Recording(signals["quiet"] * step, rate, 0.0)])
    poses: dict[str, Any] = {}
    for key in keys(signals):
        device = device_of(key)
        recording = Recording(signals[f"{key}_heard"] * step, rate, 0.02, clock=float(signals[f"{key}_clock"]))
        localizer = Localizer(sensors, device, noise, estimator)  # type: ignore[arg-type]
        off = quaternion_from_rotation_vector(np.radians([3.0, -4.0, 0.0]))
        near = multiply_quaternions(off, quaternion_from_matrix(signals[f"{key}_turn"]))
        prior = Pose(recording.middle, signals[f"{key}_position"] + [1.2e-3, -1.2e-3, 1e-3], near, 1e-6 * np.eye(6))
        with limit_to_one_thread():
            poses[key] = {"cold": localizer.locate(recording), "near": localizer.locate(recording, prior)}
    return poses


def device_of(key: str) -> Any:
    """The device of a window, as its key tells."""
    from smolbot.core.sensing import Device

    _, damping, along, _ = key.split("_")
    body = np.array([0.0, 0.0, 1.0] if along == "z" else [1.0, 0.0, 0.0])
    model = "exponential" if float(damping) > 25 else "linear"
    return Device(MOMENT, body, L0, SWING, FREQUENCY, float(damping), model)  # type: ignore[arg-type]


if __name__ == "__main__":
    buffer = BytesIO()
    np.savez(buffer, **make())
    add_windows(SIGNALS / f"{sys.argv[1]}.npz.xz", lzma.compress(buffer.getvalue(), preset=9))
