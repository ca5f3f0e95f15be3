"""A card of the twin with an echo behind it, on a free port, and the real client library in front."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from sim.twin.card_model import CardModel
from sim.twin.device_server import DeviceServer
from smolbot.bench.hardware.card import Card
from smolbot.bench.hardware.driver import Driver
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.core.arrays import FloatArray


@dataclass
class Echo:
    """Stands where the tank does: keeps every current, reads as a sensor's number in V and a sample's in µV."""

    loads: tuple[str, ...]
    rate: float = 50_000.0
    played: int = 0
    pieces: list[FloatArray] = field(default_factory=list)

    def advance(self, currents: FloatArray) -> None:
        self.pieces.append(currents)
        self.played += currents.shape[1]

    def begin_acquisition(self) -> None:
        pass

    def read_volts(self, first: int, n: int) -> FloatArray:
        return np.tile(1e-6 * np.arange(first, first + n), (10, 1)) + np.arange(10)[:, None]

    @property
    def currents(self) -> FloatArray:
        return np.concatenate(self.pieces, axis=1)


class NoGuard:
    """Arms nothing."""

    def arm(self) -> None:
        pass

    def disarm(self) -> None:
        pass

    def abandon(self) -> None:
        pass

    def check_relays_open(self) -> None:
        pass


@dataclass
class Bench:
    """Client and twin of one test."""

    section: BenchSection
    coils: tuple[str, ...]
    echo: Echo
    model: CardModel
    server: DeviceServer
    driver: Driver
    card: Card

    def open_another_driver(self) -> Driver:
        """Another connection of the client library to the same server."""
        return Driver(self.section.server, 1e-3 * self.section.call_timeout_ms)


@pytest.fixture(scope="session")
def wiring() -> tuple[BenchSection, tuple[str, ...]]:
    """The shipped bench's wiring, and its actuation coils."""
    rig = load_rig("twin")
    section, faults = validate(BenchSection, rig.raw_section("bench"), ("bench",))
    assert section is not None, faults
    return section, rig.coil_names


@pytest.fixture
def bench(wiring: tuple[BenchSection, tuple[str, ...]]) -> Iterator[Bench]:
    """A card that was opened by the real client library, over gRPC."""
    section, coils = wiring
    echo = Echo(tuple(load.name for load in section.loads))
    model = CardModel(section, echo)
    model.start()
    server = DeviceServer(model, "127.0.0.1:0")
    here = section.model_copy(update={"server": server.address})
    with contextlib.ExitStack() as closing:
        closing.callback(model.close)
        closing.callback(server.close)
        driver = Driver(here.server, 1e-3 * here.call_timeout_ms)
        closing.callback(driver.close)
        card = Card(here, echo.rate, driver)
        closing.callback(card.close)
        yield Bench(here, coils, echo, model, server, driver, card)


@pytest.fixture
def no_guard() -> NoGuard:
    return NoGuard()


@pytest.fixture
def echo_of() -> Callable[[tuple[str, ...]], Echo]:
    return Echo
