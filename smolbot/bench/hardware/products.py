"""Capabilities of the supported data acquisition cards: channels, ranges and clocked lines."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Product:
    """One type of card.

    Attributes
    ----------
    outputs : tuple of str
        Analog outputs.
    inputs : tuple of (str, tuple of str)
        Each a terminal configuration with the analog inputs that it has.
    input_ranges : tuple of float, in V
        Half widths.
    output_ranges : tuple of float, in V
        Half widths.
    clocked_lines : tuple of str
        Digital lines that can follow a sample clock.
    lines : tuple of str
        All digital lines.
    max_output_rate : float, in Hz
        With all outputs in use.
    max_input_rate : float, in Hz
        Of all inputs together.
    """

    outputs: tuple[str, ...]
    inputs: tuple[tuple[str, tuple[str, ...]], ...]
    input_ranges: tuple[float, ...]
    output_ranges: tuple[float, ...]
    clocked_lines: tuple[str, ...]
    lines: tuple[str, ...]
    max_output_rate: float
    max_input_rate: float

    def get_inputs(self, terminal: str) -> tuple[str, ...]:
        """Return the inputs of a terminal configuration.

        Parameters
        ----------
        terminal : str

        Returns
        -------
        tuple of str
            Empty if the configuration is unknown.
        """
        return dict(self.inputs).get(terminal, ())


def _number_channels(prefix: str, *spans: range) -> tuple[str, ...]:
    return tuple(f"{prefix}{number}" for span in spans for number in span)


_SINGLE = _number_channels("ai", range(32))
_PORT0 = _number_channels("port0/line", range(32))

PCIE_6363 = Product(
    outputs=_number_channels("ao", range(4)),
    inputs=(
        ("differential", _number_channels("ai", range(8), range(16, 24))),
        ("rse", _SINGLE),
        ("nrse", _SINGLE),
    ),
    input_ranges=(0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
    output_ranges=(5.0, 10.0),
    clocked_lines=_PORT0,
    lines=_PORT0 + _number_channels("port1/line", range(8)) + _number_channels("port2/line", range(8)),
    max_output_rate=1.25e6,
    max_input_rate=1.0e6,
)

PRODUCTS = {"PCIe-6363": PCIE_6363, "PXIe-6363": PCIE_6363, "USB-6363": PCIE_6363}
"""Capabilities by the product type that the driver reports."""
