"""The ``[bench.supply]`` section of a rig file: the coils' power supply and the settings of its channels."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from smolbot.config.document import FileModel
from smolbot.config.units import SI, Positive

_SOCKET = re.compile(r"TCPIP\d*::([^:\s]+)::(\d{1,5})::SOCKET", re.IGNORECASE)


class SupplyChannelSection(FileModel):
    """One channel: its settings, and the levels at which it switches itself off."""

    channel: Annotated[int, Field(ge=1, le=4)]
    feeds: str = ""
    voltage_v: Positive
    current_a: Positive
    ovp_v: Positive
    fuse: bool = True

    @model_validator(mode="after")
    def _check_protection(self) -> SupplyChannelSection:
        if self.ovp_v <= self.voltage_v:
            raise ValueError(f"ovp_v must lie above voltage_v = {self.voltage_v:g}; got {self.ovp_v:g}.")
        return self

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"channel {self.channel}" + (f" ({self.feeds})" if self.feeds else "")


class SupplySection(FileModel):
    """A supply that is set and switched by SCPI over a socket.

    `model` is the start of its model name; `timeout_ms` is the deadline of every exchange.
    """

    address: str
    model: str = "NGP8"
    timeout_ms: Annotated[float, Field(ge=50, le=10000)] = 500.0
    channels: Annotated[list[SupplyChannelSection], Field(min_length=1)]

    timeout = SI("timeout_ms")

    @field_validator("address")
    @classmethod
    def _check_socket(cls, value: str) -> str:
        found = _SOCKET.fullmatch(value)
        if found is None or not 0 < int(found[2]) < 65536:
            raise ValueError(
                f"must name a socket, such as TCPIP::192.168.1.20::5025::SOCKET (a supply of this class listens on "
                f"5025); got '{value}'."
            )
        return value

    @model_validator(mode="after")
    def _check_channels_unique(self) -> SupplySection:
        numbers = [c.channel for c in self.channels]
        twice = sorted({n for n in numbers if numbers.count(n) > 1})
        if twice:
            raise ValueError(f"channel {twice[0]} is set twice; each channel has one entry in channels.")
        return self

    @property
    def where(self) -> str:
        """Host and port, for messages."""
        found = _SOCKET.fullmatch(self.address)
        assert found is not None
        return f"{found[1]}:{found[2]}"
