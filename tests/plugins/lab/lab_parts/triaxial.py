"""Sensors of the lab's own: magnetometers that hear all three axes at one place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smolbot.config import FileModel


class TriaxialSection(FileModel):
    """[sensors] of triaxial magnetometers."""

    places_mm: list[tuple[float, float, float]]
    sample_rate_hz: float = 50_000.0
    full_scale_ut: float = 10.0
    adc_bits: int = 16


class Triaxial:
    """Each magnetometer is three single-axis sensors at one place."""

    section = TriaxialSection

    @staticmethod
    def expand(section: TriaxialSection) -> Mapping[str, Any]:
        """Single-axis sensors, three for each place."""
        if len(section.places_mm) < 2:
            raise ValueError(f"needs at least two places_mm; got {len(section.places_mm)}.")
        return {
            "positions_mm": [place for place in section.places_mm for _ in "xyz"],
            "axes": [axis for _ in section.places_mm for axis in "xyz"],
            "sample_rate_hz": section.sample_rate_hz,
            "range_ut": section.full_scale_ut,
            "adc_bits": section.adc_bits,
        }
