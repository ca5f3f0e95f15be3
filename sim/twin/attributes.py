"""What a client asks of tasks and devices by the number of an attribute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import nidaqmx._stubs.nidaqmx_pb2 as messages
from nidaqmx._stubs.nidaqmx_pb2_grpc import NiDAQmxServicer

from sim.twin.cardmodel import CardError, CardModel
from sim.twin.tasks import Tasks, TwinTask

SERIAL_NUMBER = 0x0000_7013
DRIVER_VERSION = {0x1272: 23, 0x1923: 3, 0x2F22: 0}
_CHANNEL_TYPE = {"ai": 10100, "ao": 10102, "di": 10151, "do": 10153}
_FINITE, _VOLTAGE = 10178, 10322

Answer = Callable[[TwinTask], Any]


class Attributes(NiDAQmxServicer):  # type: ignore[misc,unused-ignore]
    """The calls that read attributes; an attribute that no bench needs is an error of the card."""

    card: CardModel
    tasks: Tasks

    def _call(self, context: Any, action: Callable[[], Any]) -> Any:
        raise NotImplementedError

    def _of_task(
        self, request: Any, context: Any, response: Any, answers: dict[int, Answer], key: str = "value"
    ) -> Any:
        def run() -> Any:
            task = self.tasks.get(request.task.name)
            return response(**{key: _chosen(request, answers)(task)})

        return self._call(context, run)

    def _of_device(self, request: Any, context: Any, response: Any, answers: dict[int, Any]) -> Any:
        def run() -> Any:
            self.must_be_ours(request.device_name)
            return response(value=_chosen(request, answers))

        return self._call(context, run)

    def must_be_ours(self, name: str) -> None:
        """Raise `CardError` for the name of another device."""
        if name != self.tasks.device:
            raise CardError(-200220, f"Device identifier is invalid: '{name}'; this machine has '{self.tasks.device}'.")

    def GetTaskAttributeString(self, request: Any, context: Any) -> Any:
        answers: dict[int, Answer] = {0x1276: lambda task: task.name, 0x1273: self._names}
        return self._of_task(request, context, messages.GetTaskAttributeStringResponse, answers)

    def GetReadAttributeString(self, request: Any, context: Any) -> Any:
        return self._of_task(request, context, messages.GetReadAttributeStringResponse, {0x1823: self._names})

    def GetReadAttributeUInt32(self, request: Any, context: Any) -> Any:
        answers: dict[int, Answer] = {0x217B: _channels, 0x217C: _lines_each, 0x1223: self._available}
        return self._of_task(request, context, messages.GetReadAttributeUInt32Response, answers)

    def GetReadAttributeUInt64(self, request: Any, context: Any) -> Any:
        answers: dict[int, Answer] = {0x192A: lambda task: self.card.acquired() if task.kind == "ai" else 0}
        return self._of_task(request, context, messages.GetReadAttributeUInt64Response, answers)

    def GetWriteAttributeUInt32(self, request: Any, context: Any) -> Any:
        answers: dict[int, Answer] = {0x217E: _channels, 0x217F: _lines_each}
        return self._of_task(request, context, messages.GetWriteAttributeUInt32Response, answers)

    def GetChanAttributeInt32(self, request: Any, context: Any) -> Any:
        answers: dict[int, Answer] = {0x187F: lambda task: _CHANNEL_TYPE[task.kind], 0x2195: lambda task: _VOLTAGE}
        return self._of_task(request, context, messages.GetChanAttributeInt32Response, answers, "value_raw")

    def GetTimingAttributeDouble(self, request: Any, context: Any) -> Any:
        return self._of_task(
            request, context, messages.GetTimingAttributeDoubleResponse, {0x1344: lambda task: task.rate}
        )

    def GetTimingAttributeInt32(self, request: Any, context: Any) -> Any:
        return self._of_task(
            request, context, messages.GetTimingAttributeInt32Response, {0x1300: lambda task: _FINITE}, "value_raw"
        )

    def GetTimingAttributeUInt64(self, request: Any, context: Any) -> Any:
        return self._of_task(
            request, context, messages.GetTimingAttributeUInt64Response, {0x1310: lambda task: task.count}
        )

    def GetDeviceAttributeString(self, request: Any, context: Any) -> Any:
        answers = {0x0631: self.card.section.product}
        return self._of_device(request, context, messages.GetDeviceAttributeStringResponse, answers)

    def GetDeviceAttributeUInt32(self, request: Any, context: Any) -> Any:
        return self._of_device(request, context, messages.GetDeviceAttributeUInt32Response, {0x0632: SERIAL_NUMBER})

    def GetDeviceAttributeBool(self, request: Any, context: Any) -> Any:
        return self._of_device(request, context, messages.GetDeviceAttributeBoolResponse, {0x22CA: True})

    def GetSystemInfoAttributeUInt32(self, request: Any, context: Any) -> Any:
        return self._call(
            context, lambda: messages.GetSystemInfoAttributeUInt32Response(value=_chosen(request, DRIVER_VERSION))
        )

    def GetSystemInfoAttributeString(self, request: Any, context: Any) -> Any:
        answers = {0x193B: self.tasks.device}
        return self._call(
            context, lambda: messages.GetSystemInfoAttributeStringResponse(value=_chosen(request, answers))
        )

    def GetWatchdogAttributeBool(self, request: Any, context: Any) -> Any:
        return self._of_task(
            request, context, messages.GetWatchdogAttributeBoolResponse, {0x21A8: lambda task: self.card.expired}
        )

    def _names(self, task: TwinTask) -> str:
        return ", ".join(f"{self.tasks.device}/{channel}" for channel in task.channels[: _channels(task)])

    def _available(self, task: TwinTask) -> int:
        return self.card.available() if task.kind == "ai" else 0


def _channels(task: TwinTask) -> int:
    """Channels of a task: lines that were grouped are one."""
    return 1 if task.grouped else len(task.channels)


def _lines_each(task: TwinTask) -> int:
    return len(task.channels) if task.grouped else 1


def _chosen(request: Any, answers: dict[int, Any]) -> Any:
    attribute = request.attribute_raw or request.attribute
    if attribute not in answers:
        raise CardError(-200452, f"Specified property is not supported by the device: 0x{attribute:04X}.")
    return answers[attribute]
