"""gRPC calls that query attributes of tasks and devices by the attribute's number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import nidaqmx._stubs.nidaqmx_pb2 as messages
from nidaqmx._stubs.nidaqmx_pb2_grpc import NiDAQmxServicer

from sim.twin.card_model import UNKNOWN_DEVICE, CardError, CardModel
from sim.twin.tasks import Tasks, TwinTask

# Attributes by their numbers in the driver's header, NIDAQmx.h: of a task, of reading and writing
TASK_NAME, TASK_CHANNELS = 0x1276, 0x1273
READ_CHANNELS, READ_N_CHANNELS, READ_LINES, AVAILABLE, ACQUIRED = 0x1823, 0x217B, 0x217C, 0x1223, 0x192A
WRITE_N_CHANNELS, WRITE_LINES = 0x217E, 0x217F
# Of a channel, of timing, of the device, of the system, of a watchdog
CHANNEL_TYPE, MEASUREMENT_TYPE = 0x187F, 0x0695
CLOCK_RATE, SAMPLE_MODE, SAMPLES_PER_CHANNEL = 0x1344, 0x1300, 0x1310
PRODUCT_TYPE, SERIAL, SIMULATED = 0x0631, 0x0632, 0x22CA
DEVICE_NAMES, MAJOR_VERSION, MINOR_VERSION, UPDATE_VERSION = 0x193B, 0x1272, 0x1923, 0x2F22
EXPIRED = 0x21A8

SERIAL_NUMBER = 0x0000_7013
DRIVER_VERSION = {MAJOR_VERSION: 23, MINOR_VERSION: 3, UPDATE_VERSION: 0}
# Values of attributes in the same header
_CHANNEL_TYPE = {"ai": 10100, "ao": 10102, "di": 10151, "do": 10153}
_FINITE, _VOLTAGE = 10178, 10322

Answer = Callable[[TwinTask], Any]


class AttributeServicer(NiDAQmxServicer):  # type: ignore[misc,unused-ignore]
    """The calls that query attributes; an attribute that no bench needs is an error of the card.

    Attributes
    ----------
    card : CardModel
    tasks : Tasks
    """

    card: CardModel
    tasks: Tasks

    def _run_call(self, context: Any, action: Callable[[], Any]) -> Any:
        raise NotImplementedError

    def _answer_for_task(
        self, request: Any, context: Any, response: Any, answers: dict[int, Answer], key: str = "value"
    ) -> Any:
        def run() -> Any:
            task = self.tasks.get(request.task.name)
            return response(**{key: _find_answer(request, answers)(task)})

        return self._run_call(context, run)

    def _answer_for_device(self, request: Any, context: Any, response: Any, answers: dict[int, Any]) -> Any:
        def run() -> Any:
            self.check_device_name(request.device_name)
            return response(value=_find_answer(request, answers))

        return self._run_call(context, run)

    def check_device_name(self, name: str) -> None:
        """Check that a device name is this card's.

        Parameters
        ----------
        name : str

        Raises
        ------
        CardError
            For another name.
        """
        if name != self.tasks.device:
            raise CardError(
                UNKNOWN_DEVICE, f"Device identifier is invalid: '{name}'; this machine has '{self.tasks.device}'."
            )

    def GetTaskAttributeString(self, request: Any, context: Any) -> Any:
        """Return a string attribute of a task.

        Parameters
        ----------
        request, context : GetTaskAttributeStringRequest, grpc.ServicerContext

        Returns
        -------
        GetTaskAttributeStringResponse
        """
        answers: dict[int, Answer] = {TASK_NAME: lambda task: task.name, TASK_CHANNELS: self._list_names}
        return self._answer_for_task(request, context, messages.GetTaskAttributeStringResponse, answers)

    def GetReadAttributeString(self, request: Any, context: Any) -> Any:
        """Return a string attribute of a task for reading.

        Parameters
        ----------
        request, context : GetReadAttributeStringRequest, grpc.ServicerContext

        Returns
        -------
        GetReadAttributeStringResponse
        """
        return self._answer_for_task(
            request, context, messages.GetReadAttributeStringResponse, {READ_CHANNELS: self._list_names}
        )

    def GetReadAttributeUInt32(self, request: Any, context: Any) -> Any:
        """Return a 32-bit attribute of a task for reading.

        Parameters
        ----------
        request, context : GetReadAttributeUInt32Request, grpc.ServicerContext

        Returns
        -------
        GetReadAttributeUInt32Response
        """
        answers: dict[int, Answer] = {
            READ_N_CHANNELS: _count_channels,
            READ_LINES: _count_lines_each,
            AVAILABLE: self._count_available,
        }
        return self._answer_for_task(request, context, messages.GetReadAttributeUInt32Response, answers)

    def GetReadAttributeUInt64(self, request: Any, context: Any) -> Any:
        """Return a 64-bit attribute of a task for reading.

        Parameters
        ----------
        request, context : GetReadAttributeUInt64Request, grpc.ServicerContext

        Returns
        -------
        GetReadAttributeUInt64Response
        """
        answers: dict[int, Answer] = {ACQUIRED: lambda task: self.card.count_acquired() if task.kind == "ai" else 0}
        return self._answer_for_task(request, context, messages.GetReadAttributeUInt64Response, answers)

    def GetWriteAttributeUInt32(self, request: Any, context: Any) -> Any:
        """Return a 32-bit attribute of a task for writing.

        Parameters
        ----------
        request, context : GetWriteAttributeUInt32Request, grpc.ServicerContext

        Returns
        -------
        GetWriteAttributeUInt32Response
        """
        answers: dict[int, Answer] = {WRITE_N_CHANNELS: _count_channels, WRITE_LINES: _count_lines_each}
        return self._answer_for_task(request, context, messages.GetWriteAttributeUInt32Response, answers)

    def GetChanAttributeInt32(self, request: Any, context: Any) -> Any:
        """Return an integer attribute of a channel.

        Parameters
        ----------
        request, context : GetChanAttributeInt32Request, grpc.ServicerContext

        Returns
        -------
        GetChanAttributeInt32Response
        """
        answers: dict[int, Answer] = {
            CHANNEL_TYPE: lambda task: _CHANNEL_TYPE[task.kind],
            MEASUREMENT_TYPE: lambda task: _VOLTAGE,
        }
        return self._answer_for_task(request, context, messages.GetChanAttributeInt32Response, answers, "value_raw")

    def GetTimingAttributeDouble(self, request: Any, context: Any) -> Any:
        """Return a floating-point attribute of a task's timing.

        Parameters
        ----------
        request, context : GetTimingAttributeDoubleRequest, grpc.ServicerContext

        Returns
        -------
        GetTimingAttributeDoubleResponse
        """
        return self._answer_for_task(
            request, context, messages.GetTimingAttributeDoubleResponse, {CLOCK_RATE: lambda task: task.rate}
        )

    def GetTimingAttributeInt32(self, request: Any, context: Any) -> Any:
        """Return a 32-bit attribute of a task's timing.

        Parameters
        ----------
        request, context : GetTimingAttributeInt32Request, grpc.ServicerContext

        Returns
        -------
        GetTimingAttributeInt32Response
        """
        return self._answer_for_task(
            request, context, messages.GetTimingAttributeInt32Response, {SAMPLE_MODE: lambda task: _FINITE}, "value_raw"
        )

    def GetTimingAttributeUInt64(self, request: Any, context: Any) -> Any:
        """Return a 64-bit attribute of a task's timing.

        Parameters
        ----------
        request, context : GetTimingAttributeUInt64Request, grpc.ServicerContext

        Returns
        -------
        GetTimingAttributeUInt64Response
        """
        return self._answer_for_task(
            request, context, messages.GetTimingAttributeUInt64Response, {SAMPLES_PER_CHANNEL: lambda task: task.count}
        )

    def GetDeviceAttributeString(self, request: Any, context: Any) -> Any:
        """Return a string attribute of the card.

        Parameters
        ----------
        request, context : GetDeviceAttributeStringRequest, grpc.ServicerContext

        Returns
        -------
        GetDeviceAttributeStringResponse
        """
        answers = {PRODUCT_TYPE: self.card.section.product}
        return self._answer_for_device(request, context, messages.GetDeviceAttributeStringResponse, answers)

    def GetDeviceAttributeUInt32(self, request: Any, context: Any) -> Any:
        """Return an integer attribute of the card.

        Parameters
        ----------
        request, context : GetDeviceAttributeUInt32Request, grpc.ServicerContext

        Returns
        -------
        GetDeviceAttributeUInt32Response
        """
        return self._answer_for_device(
            request, context, messages.GetDeviceAttributeUInt32Response, {SERIAL: SERIAL_NUMBER}
        )

    def GetDeviceAttributeBool(self, request: Any, context: Any) -> Any:
        """Return a Boolean attribute of the card.

        Parameters
        ----------
        request, context : GetDeviceAttributeBoolRequest, grpc.ServicerContext

        Returns
        -------
        GetDeviceAttributeBoolResponse
        """
        return self._answer_for_device(request, context, messages.GetDeviceAttributeBoolResponse, {SIMULATED: True})

    def GetSystemInfoAttributeUInt32(self, request: Any, context: Any) -> Any:
        """Return an integer attribute of the system.

        Parameters
        ----------
        request, context : GetSystemInfoAttributeUInt32Request, grpc.ServicerContext

        Returns
        -------
        GetSystemInfoAttributeUInt32Response
        """
        return self._run_call(
            context, lambda: messages.GetSystemInfoAttributeUInt32Response(value=_find_answer(request, DRIVER_VERSION))
        )

    def GetSystemInfoAttributeString(self, request: Any, context: Any) -> Any:
        """Return a string attribute of the system.

        Parameters
        ----------
        request, context : GetSystemInfoAttributeStringRequest, grpc.ServicerContext

        Returns
        -------
        GetSystemInfoAttributeStringResponse
        """
        answers = {DEVICE_NAMES: self.tasks.device}
        return self._run_call(
            context, lambda: messages.GetSystemInfoAttributeStringResponse(value=_find_answer(request, answers))
        )

    def GetWatchdogAttributeBool(self, request: Any, context: Any) -> Any:
        """Return a Boolean attribute of the watchdog.

        Parameters
        ----------
        request, context : GetWatchdogAttributeBoolRequest, grpc.ServicerContext

        Returns
        -------
        GetWatchdogAttributeBoolResponse
        """
        return self._answer_for_task(
            request, context, messages.GetWatchdogAttributeBoolResponse, {EXPIRED: lambda task: self.card.expired}
        )

    def _list_names(self, task: TwinTask) -> str:
        return ", ".join(f"{self.tasks.device}/{channel}" for channel in task.channels[: _count_channels(task)])

    def _count_available(self, task: TwinTask) -> int:
        return self.card.count_available() if task.kind == "ai" else 0


def _count_channels(task: TwinTask) -> int:
    """Return the number of channels of a task; grouped lines are one channel."""
    return 1 if task.grouped else len(task.channels)


def _count_lines_each(task: TwinTask) -> int:
    return len(task.channels) if task.grouped else 1


def _find_answer(request: Any, answers: dict[int, Any]) -> Any:
    attribute = request.attribute_raw or request.attribute
    if attribute not in answers:
        raise CardError(-200452, f"Specified property is not supported by the device: 0x{attribute:04X}.")
    return answers[attribute]
