"""The NI device server of the twin, called by the unmodified client library over gRPC."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import grpc
import nidaqmx._stubs.nidaqmx_pb2 as messages
import numpy as np
from session_pb2 import Session

from sim.twin.attributes import AttributeServicer
from sim.twin.card_model import DEVICE_GONE, UNKNOWN_DEVICE, UNSUPPORTED, CardError, CardModel
from sim.twin.tasks import Tasks, TwinTask

STALL_POLL_INTERVAL = 0.01
"""Time, in s, between two checks whether a stalled server continues."""

# Actions by their numbers in the driver
ABORT, FOR_ALL_LINES = 6, 1
TERMINALS = {-1: "differential", 10106: "differential", 10083: "rse", 10078: "nrse"}
RESET_TIMER = 0


class TwinServicer(AttributeServicer):
    """Serves one card; calls that no bench needs stay unimplemented, as on an old server.

    Parameters
    ----------
    card : CardModel
    """

    def __init__(self, card: CardModel) -> None:
        self.card, self.tasks = card, Tasks(card)

    def _run_call(self, context: Any, action: Callable[[], Any]) -> Any:
        """Run one call, unless the card is gone or the server stalls; errors are sent as by the real server."""
        faults = self.card.faults
        while faults.is_active("stalled") and context.is_active():
            time.sleep(STALL_POLL_INTERVAL)
        if not context.is_active():  # its client has given up: the call is not carried out late
            context.abort(grpc.StatusCode.CANCELLED, "the call is over")
        try:
            if faults.take("device_gone"):
                raise CardError(
                    DEVICE_GONE, "Device cannot be accessed: it was disconnected, or the system was suspended."
                )
            return action()
        except CardError as error:
            trailing = [("ni-error", str(error.code))]
            if error.read is not None:
                trailing.append(("ni-samps-per-chan-read", str(error.read)))
            if error.written is not None:
                trailing.append(("ni-samps-per-chan-written", str(error.written)))
            context.set_trailing_metadata(tuple(trailing))
            context.abort(grpc.StatusCode.UNKNOWN, str(error))

    def _call_on_task(self, request: Any, context: Any, response: Any, action: Callable[[TwinTask], Any]) -> Any:
        """Run one call on a task, with an empty answer."""

        def run() -> Any:
            action(self.tasks.get(request.task.name))
            return response()

        return self._run_call(context, run)

    # tasks

    def CreateTask(self, request: Any, context: Any) -> Any:
        """Create a task.

        Parameters
        ----------
        request, context : CreateTaskRequest, grpc.ServicerContext

        Returns
        -------
        CreateTaskResponse
        """
        return self._run_call(context, lambda: self._create_task(messages.CreateTaskResponse, request.session_name))

    def CreateWatchdogTimerTaskEx(self, request: Any, context: Any) -> Any:
        """Create a watchdog task.

        Parameters
        ----------
        request, context : CreateWatchdogTimerTaskExRequest, grpc.ServicerContext

        Returns
        -------
        CreateWatchdogTimerTaskExResponse
        """

        def run() -> Any:
            if request.device_name != self.tasks.device:
                raise CardError(UNKNOWN_DEVICE, f"Device identifier is invalid: '{request.device_name}'.")
            response = self._create_task(messages.CreateWatchdogTimerTaskExResponse, request.session_name, "watchdog")
            self.tasks.get(response.task.name).timeout = request.timeout
            return response

        return self._run_call(context, run)

    def _create_task(self, response: Any, name: str, kind: str = "") -> Any:
        task = self.tasks.create(name, kind)
        return response(task=Session(name=task.name), new_session_initialized=True)

    def ClearTask(self, request: Any, context: Any) -> Any:
        """Stop and remove a task.

        Parameters
        ----------
        request, context : ClearTaskRequest, grpc.ServicerContext

        Returns
        -------
        ClearTaskResponse
        """
        return self._call_on_task(
            request, context, messages.ClearTaskResponse, lambda task: self.tasks.clear(task.name)
        )

    def StartTask(self, request: Any, context: Any) -> Any:
        """Start a task.

        Parameters
        ----------
        request, context : StartTaskRequest, grpc.ServicerContext

        Returns
        -------
        StartTaskResponse
        """
        return self._call_on_task(request, context, messages.StartTaskResponse, self.tasks.start)

    def StopTask(self, request: Any, context: Any) -> Any:
        """Stop a task.

        Parameters
        ----------
        request, context : StopTaskRequest, grpc.ServicerContext

        Returns
        -------
        StopTaskResponse
        """
        return self._call_on_task(request, context, messages.StopTaskResponse, self.tasks.stop)

    def TaskControl(self, request: Any, context: Any) -> Any:
        """Abort a task.

        Parameters
        ----------
        request, context : TaskControlRequest, grpc.ServicerContext

        Returns
        -------
        TaskControlResponse
        """

        def run(task: TwinTask) -> None:
            action = request.action_raw or request.action
            if action != ABORT:
                raise CardError(UNSUPPORTED, f"The twin can only abort a task; got action {action}.")
            self.tasks.stop(task)
            task.buffer = None

        return self._call_on_task(request, context, messages.TaskControlResponse, run)

    def IsTaskDone(self, request: Any, context: Any) -> Any:
        """Report whether a task is done.

        Parameters
        ----------
        request, context : IsTaskDoneRequest, grpc.ServicerContext

        Returns
        -------
        IsTaskDoneResponse
        """
        return self._run_call(
            context,
            lambda: messages.IsTaskDoneResponse(is_task_done=self.tasks.wait(self.tasks.get(request.task.name), 0.0)),
        )

    def WaitUntilTaskDone(self, request: Any, context: Any) -> Any:
        """Wait until a task is done.

        Parameters
        ----------
        request, context : WaitUntilTaskDoneRequest, grpc.ServicerContext

        Returns
        -------
        WaitUntilTaskDoneResponse
        """

        def run(task: TwinTask) -> None:
            if not self.tasks.wait(task, max(request.time_to_wait, 0.0)):
                raise CardError(-200560, "Wait Until Done did not indicate that the task was done within the timeout.")

        return self._call_on_task(request, context, messages.WaitUntilTaskDoneResponse, run)

    # channels and timing

    def CreateAIVoltageChan(self, request: Any, context: Any) -> Any:
        """Add analog inputs to a task.

        Parameters
        ----------
        request, context : CreateAIVoltageChanRequest, grpc.ServicerContext

        Returns
        -------
        CreateAIVoltageChanResponse
        """
        span = (request.min_val, request.max_val)
        return self._call_on_task(
            request, context, messages.CreateAIVoltageChanResponse,
            lambda task: self.tasks.add_channels(task, "ai", request.physical_channel, span, _read_terminal(request)),
        )  # fmt: skip

    def CreateAOVoltageChan(self, request: Any, context: Any) -> Any:
        """Add analog outputs to a task.

        Parameters
        ----------
        request, context : CreateAOVoltageChanRequest, grpc.ServicerContext

        Returns
        -------
        CreateAOVoltageChanResponse
        """
        span = (request.min_val, request.max_val)
        return self._call_on_task(
            request, context, messages.CreateAOVoltageChanResponse,
            lambda task: self.tasks.add_channels(task, "ao", request.physical_channel, span),
        )  # fmt: skip

    def CreateDOChan(self, request: Any, context: Any) -> Any:
        """Add digital outputs to a task.

        Parameters
        ----------
        request, context : CreateDOChanRequest, grpc.ServicerContext

        Returns
        -------
        CreateDOChanResponse
        """
        return self._call_on_task(
            request, context, messages.CreateDOChanResponse, lambda task: self._add_lines(task, "do", request)
        )

    def CreateDIChan(self, request: Any, context: Any) -> Any:
        """Add digital inputs to a task.

        Parameters
        ----------
        request, context : CreateDIChanRequest, grpc.ServicerContext

        Returns
        -------
        CreateDIChanResponse
        """
        return self._call_on_task(
            request, context, messages.CreateDIChanResponse, lambda task: self._add_lines(task, "di", request)
        )

    def _add_lines(self, task: TwinTask, kind: str, request: Any) -> None:
        self.tasks.add_channels(task, kind, request.lines)
        task.grouped = (request.line_grouping_raw or request.line_grouping) == FOR_ALL_LINES

    def CfgSampClkTiming(self, request: Any, context: Any) -> Any:
        """Set the sample clock of a task.

        Parameters
        ----------
        request, context : CfgSampClkTimingRequest, grpc.ServicerContext

        Returns
        -------
        CfgSampClkTimingResponse
        """
        return self._call_on_task(
            request, context, messages.CfgSampClkTimingResponse,
            lambda task: self.tasks.set_clock(task, request.rate, request.source, request.samps_per_chan),
        )  # fmt: skip

    def CfgDigEdgeStartTrig(self, request: Any, context: Any) -> Any:
        """Set the start trigger of a task.

        Parameters
        ----------
        request, context : CfgDigEdgeStartTrigRequest, grpc.ServicerContext

        Returns
        -------
        CfgDigEdgeStartTrigResponse
        """

        def run(task: TwinTask) -> None:
            task.trigger = request.trigger_source

        return self._call_on_task(request, context, messages.CfgDigEdgeStartTrigResponse, run)

    # reading and writing

    def ReadAnalogF64(self, request: Any, context: Any) -> Any:
        """Read samples of a task's analog inputs.

        Parameters
        ----------
        request, context : ReadAnalogF64Request, grpc.ServicerContext

        Returns
        -------
        ReadAnalogF64Response
        """

        def run() -> Any:
            task = self.tasks.get(request.task.name)
            if task.kind != "ai":
                raise CardError(-200028, "Only a task of inputs can be read.", read=0)
            volts = self.tasks.read(task, request.num_samps_per_chan, max(request.timeout, 0.0))
            return messages.ReadAnalogF64Response(
                read_array=np.ascontiguousarray(volts).ravel().tolist(), samps_per_chan_read=volts.shape[1]
            )

        return self._run_call(context, run)

    def WriteAnalogF64(self, request: Any, context: Any) -> Any:
        """Write samples for a task's analog outputs.

        Parameters
        ----------
        request, context : WriteAnalogF64Request, grpc.ServicerContext

        Returns
        -------
        WriteAnalogF64Response
        """

        def run() -> Any:
            task, n = self.tasks.get(request.task.name), request.num_samps_per_chan
            values = np.array(request.write_array, dtype=np.float64).reshape(len(task.channels), n)
            self.tasks.write(task, values, request.auto_start)
            return messages.WriteAnalogF64Response(samps_per_chan_written=n)

        return self._run_call(context, run)

    def WriteDigitalU32(self, request: Any, context: Any) -> Any:
        """Write samples for a task's digital lines.

        Parameters
        ----------
        request, context : WriteDigitalU32Request, grpc.ServicerContext

        Returns
        -------
        WriteDigitalU32Response
        """

        def run() -> Any:
            levels = np.array(request.write_array, dtype=np.uint32)
            self.tasks.write_lines(self.tasks.get(request.task.name), levels, request.auto_start)
            return messages.WriteDigitalU32Response(samps_per_chan_written=len(levels))

        return self._run_call(context, run)

    def WriteDigitalScalarU32(self, request: Any, context: Any) -> Any:
        """Write one level to each of a task's digital lines.

        Parameters
        ----------
        request, context : WriteDigitalScalarU32Request, grpc.ServicerContext

        Returns
        -------
        WriteDigitalScalarU32Response
        """
        levels = np.array([request.value], dtype=np.uint32)
        return self._call_on_task(
            request, context, messages.WriteDigitalScalarU32Response,
            lambda task: self.tasks.write_lines(task, levels, request.auto_start),
        )  # fmt: skip

    def WriteAnalogScalarF64(self, request: Any, context: Any) -> Any:
        """Write one value to a task's analog output.

        Parameters
        ----------
        request, context : WriteAnalogScalarF64Request, grpc.ServicerContext

        Returns
        -------
        WriteAnalogScalarF64Response
        """
        values = np.array([[request.value]])
        return self._call_on_task(
            request, context, messages.WriteAnalogScalarF64Response,
            lambda task: self.tasks.write(task, values, request.auto_start),
        )  # fmt: skip

    def ReadDigitalLines(self, request: Any, context: Any) -> Any:
        """Read the levels of a task's digital lines.

        Parameters
        ----------
        request, context : ReadDigitalLinesRequest, grpc.ServicerContext

        Returns
        -------
        ReadDigitalLinesResponse
        """

        def run() -> Any:
            task = self.tasks.get(request.task.name)
            levels = bytes(self.card.read_line(line) for line in task.channels)
            return messages.ReadDigitalLinesResponse(read_array=levels, samps_per_chan_read=1, num_bytes_per_samp=1)

        return self._run_call(context, run)

    # device and watchdog

    def ResetDevice(self, request: Any, context: Any) -> Any:
        """Reset the card and stop all tasks.

        Parameters
        ----------
        request, context : ResetDeviceRequest, grpc.ServicerContext

        Returns
        -------
        ResetDeviceResponse
        """

        def run() -> Any:
            self.check_device_name(request.device_name)
            self.tasks.clear_all()
            return messages.ResetDeviceResponse()

        return self._run_call(context, run)

    def SelfTestDevice(self, request: Any, context: Any) -> Any:
        """Report a passed self-test.

        Parameters
        ----------
        request, context : SelfTestDeviceRequest, grpc.ServicerContext

        Returns
        -------
        SelfTestDeviceResponse
        """

        def run() -> Any:
            self.check_device_name(request.device_name)
            return messages.SelfTestDeviceResponse()

        return self._run_call(context, run)

    def CfgWatchdogDOExpirStates(self, request: Any, context: Any) -> Any:
        """Set the lines that the watchdog switches off.

        Parameters
        ----------
        request, context : CfgWatchdogDOExpirStatesRequest, grpc.ServicerContext

        Returns
        -------
        CfgWatchdogDOExpirStatesResponse
        """

        def run(task: TwinTask) -> None:
            task.channels = []
            self.tasks.add_channels(task, "do", request.channel_names)
            task.kind = "watchdog"

        return self._call_on_task(request, context, messages.CfgWatchdogDOExpirStatesResponse, run)

    def ControlWatchdogTask(self, request: Any, context: Any) -> Any:
        """Reset the watchdog's timer, or restart it.

        Parameters
        ----------
        request, context : ControlWatchdogTaskRequest, grpc.ServicerContext

        Returns
        -------
        ControlWatchdogTaskResponse
        """

        def run(task: TwinTask) -> None:
            action = request.action_raw or request.action
            if action == RESET_TIMER:
                self.card.reset_watchdog_timer()
            else:
                self.tasks.stop(task)
                self.tasks.start(task)

        return self._call_on_task(request, context, messages.ControlWatchdogTaskResponse, run)


def _read_terminal(request: Any) -> str:
    """Return the terminal configuration of inputs; by default the one that the card prefers."""
    number = request.terminal_config_raw or request.terminal_config
    if number not in TERMINALS:
        raise CardError(UNSUPPORTED, f"Requested value is not supported: terminal configuration {number}.")
    return TERMINALS[number]
