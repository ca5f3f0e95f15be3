"""What the twin's card refuses, as the unmodified client library raises it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from nidaqmx.constants import AcquisitionType, TerminalConfiguration
from nidaqmx.errors import DaqError, DaqReadError, DaqWriteError, RpcError
from nidaqmx.stream_readers import AnalogMultiChannelReader

from sim.twin.faults import parse_fault
from tests.sim.twin.conftest import Bench

pytestmark = pytest.mark.realtime


def inputs(task: Any, name: str = "Dev1/ai0:1") -> Any:
    task.ai_channels.add_ai_voltage_chan(name, terminal_config=TerminalConfiguration.DIFF)
    return task


def started(task: Any, samples: int = 500) -> Any:
    inputs(task).timing.cfg_samp_clk_timing(50_000, sample_mode=AcquisitionType.FINITE, samps_per_chan=samples)
    task.start()
    return task


def range_of_outputs(task: Any) -> None:
    task.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    task.write(10.5)


def too_many(task: Any) -> None:
    AnalogMultiChannelReader(started(task).in_stream).read_many_sample(np.zeros((2, 501)), 501)


def unwritten(task: Any) -> None:
    task.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    task.timing.cfg_samp_clk_timing(50_000, samps_per_chan=100)
    task.start()


@pytest.mark.parametrize(
    ("code", "action"),
    [
        (-200220, lambda task: inputs(task, "Dev2/ai0")),
        (-200170, lambda task: inputs(task, "Dev1/ai99")),
        (-200170, lambda task: inputs(task, "Dev1/ai8")),  # the other leg of a differential ai0
        (-200170, lambda task: task.do_channels.add_do_chan("Dev1/port0/line32")),
        (-200489, lambda task: inputs(task, "Dev1/ai0, Dev1/ai0")),
        (-200077, lambda task: task.ai_channels.add_ai_voltage_chan("Dev1/ai0", min_val=-11, max_val=11)),
        (-200077, lambda task: inputs(task).timing.cfg_samp_clk_timing(2e6)),
        (-200077, range_of_outputs),
        (-200462, unwritten),
        (-200560, lambda task: started(task, 50_000).wait_until_done(0.02)),
        (-200278, too_many),
    ],
)
def test_what_a_card_cannot_do_is_the_drivers_own_error(bench: Bench, code: int, action: Callable[[Any], Any]) -> None:
    with bench.driver.task() as task, pytest.raises(DaqError) as raised:
        action(task)
    assert raised.value.error_code == code


def test_a_second_acquisition_finds_the_inputs_reserved(bench: Bench) -> None:
    with bench.driver.task() as first, bench.driver.task() as second:
        started(first, 50_000)
        with pytest.raises(DaqError) as raised:
            started(second)
        assert raised.value.error_code == -50103
        first.stop()
        second.start()


def test_lost_samples_are_a_read_error_and_a_refused_value_a_write_error(bench: Bench) -> None:
    with bench.driver.task() as task:
        reader = AnalogMultiChannelReader(started(task).in_stream)
        bench.model.faults.add(parse_fault("overrun@now"))
        with pytest.raises(DaqReadError) as lost:
            reader.read_many_sample(np.zeros((2, 500)), 500)
        assert (lost.value.error_code, lost.value.samps_per_chan_read) == (-200279, 0)
    with bench.driver.task() as task, pytest.raises(DaqWriteError) as refused:
        range_of_outputs(task)
    assert (refused.value.error_code, refused.value.samps_per_chan_written) == (-200077, 0)


def test_an_overrun_that_comes_while_a_read_waits_loses_that_read(bench: Bench) -> None:
    with bench.driver.task() as task:
        reader = AnalogMultiChannelReader(started(task, 10_000).in_stream)
        threading.Timer(0.05, bench.model.faults.add, [parse_fault("overrun@now")]).start()
        with pytest.raises(DaqReadError) as lost:
            reader.read_many_sample(np.zeros((2, 10_000)), 10_000)  # 0.2 s
        assert lost.value.error_code == -200279


def test_a_device_that_is_gone_for_good_answers_nothing_until_it_is_back(bench: Bench) -> None:
    device = bench.driver.get_device("Dev1")
    bench.model.faults.add(parse_fault("device_gone@now:good"))
    for _ in range(2):
        with pytest.raises(DaqError) as raised:
            device.reset_device()
        assert raised.value.error_code == -201003
    bench.model.faults.clear()
    device.reset_device()


def test_a_server_that_was_killed_comes_back_and_knows_no_task(bench: Bench) -> None:
    bench.server.kill()
    with pytest.raises(RpcError, match="UNAVAILABLE"):
        bench.card.inputs.stop()
    bench.server.restart()
    again = bench.open_another_driver()
    with again.task() as task:
        assert inputs(task).channel_names == ["Dev1/ai0", "Dev1/ai1"]
    again.close()


def test_a_task_reads_its_own_channels_in_its_own_order(bench: Bench) -> None:
    with bench.driver.task() as task:
        inputs(task, "Dev1/ai16, Dev1/ai23, Dev1/ai2")  # sensor 8, none, sensor 2
        task.timing.cfg_samp_clk_timing(50_000, samps_per_chan=20)
        data = np.array(task.read(20))
    np.testing.assert_array_equal(np.floor(data[:, 0]), [8, 0, 2])
    assert not data[1].any()


def test_attributes_read_back_what_was_set(bench: Bench) -> None:
    with bench.driver.task() as task:
        inputs(task).timing.cfg_samp_clk_timing(50_000, samps_per_chan=700)
        assert task.timing.samp_clk_rate == 50_000
        assert task.timing.samp_quant_samp_per_chan == 700
        assert task.in_stream.num_chans == 2
        data = task.read(700)
    assert np.shape(data) == (2, 700)
    device = bench.driver.get_device("Dev1")
    assert device.product_type == "PCIe-6363"
    assert device.is_simulated
