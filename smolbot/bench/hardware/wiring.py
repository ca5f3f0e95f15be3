"""The ``[bench]`` section of a rig file: which device, channel, relay and line serves what."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from smolbot.bench.hardware.products import PRODUCTS, Product
from smolbot.bench.hardware.supply_section import SupplySection
from smolbot.config.document import FileModel
from smolbot.config.units import SI, NotNegative, Positive

Key = tuple[str | int, ...]


class InputsSection(FileModel):
    """Analog inputs, one for each sensor, in the sensors' order."""

    channels: Annotated[list[str], Field(min_length=1)]
    terminal: Literal["differential", "rse", "nrse"] = "differential"
    range_v: Positive = 10.0


class OutputsSection(FileModel):
    """Analog outputs, and the line that enables the amplifiers behind them."""

    rate_hz: Positive = 50000.0
    range_v: Positive = 10.0
    enable: str


class LoadSection(FileModel):
    """One coil: the output that drives it through an amplifier, and the relay between them."""

    coil: str | None = None
    excitation: Literal["x", "y"] | None = None
    output: str
    gain_a_per_v: Positive
    relay: str

    @model_validator(mode="after")
    def _check_one_load(self) -> LoadSection:
        if (self.coil is None) == (self.excitation is None):
            raise ValueError('give either coil = "NAME" or excitation = "x" or "y".')
        return self

    @property
    def name(self) -> str:
        """Name for messages: the coil's name, or ``excitation x``."""
        return self.coil if self.coil is not None else f"excitation {self.excitation}"


class RelaysSection(FileModel):
    """Settling times of the relays, and the line that is high while all are open (auxiliary contacts in series)."""

    close_ms: NotNegative
    open_ms: NotNegative
    all_open: str | None = None

    closing = SI("close_ms")
    opening = SI("open_ms")


class WatchdogSection(FileModel):
    """The card's own timer that opens every relay unless it is fed."""

    timeout_ms: Annotated[float, Field(ge=20, le=1000)] = 100.0
    feed_ms: Annotated[float, Field(ge=2)] = 20.0

    timeout = SI("timeout_ms")
    feed = SI("feed_ms")

    @model_validator(mode="after")
    def _check_feed_interval(self) -> WatchdogSection:
        if self.feed_ms > 0.4 * self.timeout_ms:
            raise ValueError(
                f"feed_ms must be at most 0.4 of timeout_ms, so that one late feed is no alarm; got {self.feed_ms:g} "
                f"of {self.timeout_ms:g} ms."
            )
        return self


class OperatorSection(FileModel):
    """The person at the bench: a button whose line is high while all is well, and how long to wait for an answer."""

    stop_line: str | None = None
    answer_timeout_s: Positive = 120.0


class StageSection(FileModel):
    """Motors and serial port of the magnet stage; an empty port is searched for."""

    port: str = ""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 115200
    steps_per_turn: Annotated[int, Field(ge=100)] = 3200
    steering_steps_per_turn: Annotated[int, Field(ge=100)] = 16000
    switches: bool = True


class BenchSection(FileModel):
    """All hardware between the program and the coils, sensors and motors."""

    server: str = ""
    truth: str = ""
    device: str
    product: str = "PCIe-6363"
    call_timeout_ms: Annotated[float, Field(ge=20)] = 500.0
    inputs: InputsSection
    outputs: OutputsSection
    loads: Annotated[list[LoadSection], Field(min_length=1)]
    relays: RelaysSection
    watchdog: WatchdogSection = WatchdogSection()
    operator: OperatorSection = OperatorSection()
    stage: StageSection | None = None
    supply: SupplySection | None = None

    call_timeout = SI("call_timeout_ms")

    @property
    def clocked_lines(self) -> tuple[str, ...]:
        """Relay lines in the order of the loads, then the amplifiers' enable line."""
        return (*(load.relay for load in self.loads), self.outputs.enable)

    @property
    def used_outputs(self) -> tuple[str, ...]:
        """Analog outputs in the order of their numbers."""
        return tuple(sorted({load.output for load in self.loads}, key=lambda name: (len(name), name)))

    @property
    def input_lines(self) -> tuple[str, ...]:
        """Digital lines that are read, where they are wired: relay contacts and operator's button."""
        return tuple(line for line in (self.relays.all_open, self.operator.stop_line) if line is not None)


def find_wiring_faults(section: BenchSection, data: dict[str, Any]) -> Iterator[tuple[Key, str]]:
    """Find faults of the wiring that a rig file describes.

    Parameters
    ----------
    section : BenchSection
    data : dict
        The complete rig file.

    Yields
    ------
    tuple
        Key within the section, and a sentence on the fault.
    """
    product = PRODUCTS.get(section.product)
    if product is None:
        yield ("product",), f"unknown product '{section.product}'; known: {', '.join(PRODUCTS)}."
        return
    yield from _find_input_faults(section, product, data)
    yield from _find_output_faults(section, product)
    yield from _find_load_faults(section, data)
    yield from _find_line_faults(section, product)
    if (section.stage is None) != (data.get("magnet") is None):
        which = "[magnet] needs [bench.stage] to move it" if section.stage is None else "[bench.stage] needs a [magnet]"
        yield ("stage",), f"{which}."


def _find_input_faults(section: BenchSection, product: Product, data: dict[str, Any]) -> Iterator[tuple[Key, str]]:
    inputs = section.inputs
    exist = product.get_inputs(inputs.terminal)
    for number, name in enumerate(inputs.channels):
        if name not in exist:
            yield (
                ("inputs", "channels"),
                f"'{name}' (sensor {number}) is no {inputs.terminal} input of a {section.product}; "
                f"it has {_format_span(exist)}.",
            )
    yield from _find_duplicates(("inputs", "channels"), inputs.channels, "input")
    if inputs.range_v not in product.input_ranges:
        yield ("inputs", "range_v"), _format_choice(inputs.range_v, product.input_ranges)
    sensors = data.get("sensors", {})
    count = len(sensors.get("positions_mm", ())) if isinstance(sensors, dict) else 0
    if count and count != len(inputs.channels):
        yield ("inputs", "channels"), f"{len(inputs.channels)} inputs for {count} sensors; each sensor needs one."
    rate = sensors.get("sample_rate_hz") if isinstance(sensors, dict) else None
    if isinstance(rate, float | int) and rate * len(inputs.channels) > product.max_input_rate:
        yield (
            ("inputs", "channels"),
            f"{len(inputs.channels)} inputs at sensors.sample_rate_hz = {rate:g} exceed the card's "
            f"{product.max_input_rate:g} samples a second.",
        )


def _find_output_faults(section: BenchSection, product: Product) -> Iterator[tuple[Key, str]]:
    if section.outputs.range_v not in product.output_ranges:
        yield ("outputs", "range_v"), _format_choice(section.outputs.range_v, product.output_ranges)
    if section.outputs.rate_hz > product.max_output_rate:
        yield ("outputs", "rate_hz"), f"must be at most {product.max_output_rate:g}; got {section.outputs.rate_hz:g}."
    for number, load in enumerate(section.loads):
        if load.output not in product.outputs:
            yield (
                ("loads", number, "output"),
                f"'{load.output}' is no output of a {section.product}; it has {_format_span(product.outputs)}.",
            )


def _find_load_faults(section: BenchSection, data: dict[str, Any]) -> Iterator[tuple[Key, str]]:
    coils = [str(c.get("name")) for c in data.get("coils", []) if isinstance(c, dict)]
    excitation = [f"excitation {c.get('name')}" for c in data.get("excitation", []) if isinstance(c, dict)]
    wired = [load.name for load in section.loads]
    for number, name in enumerate(wired):
        if name not in coils + excitation:
            yield ("loads", number), f"this rig has no coil '{name}'; it has {', '.join(coils + excitation)}."
    missing = [name for name in coils + excitation if name not in wired]
    if missing:
        yield ("loads",), f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} wired to nothing."
    yield from _find_duplicates(("loads",), wired, "load")
    for (_, a), (j, b) in combinations(enumerate(section.loads), 2):
        if a.output == b.output and (a.excitation is None) == (b.excitation is None):
            yield (
                ("loads", j, "output"),
                f"{a.name} and {b.name} can be driven at once and so cannot share {b.output}; "
                "only a coil and an excitation coil can.",
            )
    limits = data.get("limits", {})
    for number, load in enumerate(section.loads):
        key = "max_current_a" if load.excitation is None else "max_excitation_current_a"
        most = limits.get(key) if isinstance(limits, dict) else None
        reach = load.gain_a_per_v * section.outputs.range_v
        if isinstance(most, float | int) and most > reach * (1 + 1e-9):
            yield (
                ("loads", number, "gain_a_per_v"),
                f"{load.name} can get at most {reach:g} A from ±{section.outputs.range_v:g} V; "
                f"limits.{key} is {most:g}.",
            )


def _find_line_faults(section: BenchSection, product: Product) -> Iterator[tuple[Key, str]]:
    used: dict[str, Key] = {}
    named: list[tuple[Key, str, tuple[str, ...], str]] = [
        (("loads", i, "relay"), load.relay, product.clocked_lines, "clocked line")
        for i, load in enumerate(section.loads)
    ]
    named.append((("outputs", "enable"), section.outputs.enable, product.clocked_lines, "clocked line"))
    if section.relays.all_open is not None:
        named.append((("relays", "all_open"), section.relays.all_open, product.lines, "line"))
    if section.operator.stop_line is not None:
        named.append((("operator", "stop_line"), section.operator.stop_line, product.lines, "line"))
    for key, name, exist, what in named:
        if name not in exist:
            yield key, f"'{name}' is no {what} of a {section.product}; it has {_format_span(exist)}."
        elif name in used:
            yield key, f"{name} is taken by {'.'.join(str(p) for p in used[name])}."
        used.setdefault(name, key)


def _find_duplicates(key: Key, names: list[str], what: str) -> Iterator[tuple[Key, str]]:
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield key, f"{what} '{name}' is named twice."


def _format_choice(value: float, possible: tuple[float, ...]) -> str:
    return f"must be one of {', '.join(f'{v:g}' for v in possible)}; got {value:g}."


def _format_span(names: tuple[str, ...]) -> str:
    """Abbreviate names with consecutive numbers: ``ai0 to ai7, ai16 to ai23``."""
    runs: list[list[str]] = []
    before: tuple[str, int] | None = None
    for name in names:
        stem = name.rstrip("0123456789")
        number = int(name[len(stem) :])
        if before == (stem, number - 1):
            runs[-1][1:] = [name]
        else:
            runs.append([name])
        before = (stem, number)
    return ", ".join(" to ".join(run) for run in runs) or "none"
