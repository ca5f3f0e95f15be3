"""The coils' power supply through the real client library, against a socket that speaks its SCPI."""

from __future__ import annotations

import socket
import threading

import pytest

from sim.twin.supply_model import SupplyModel, SupplyServer
from smolbot.bench.hardware.supply import Supply
from smolbot.bench.hardware.supply_section import SupplySection
from smolbot.config.document import Document, validate
from smolbot.errors import RigError

CHANNELS = [
    {"channel": 1, "feeds": "amplifiers +x, -x", "voltage_v": 24.0, "current_a": 9.0, "ovp_v": 26.0},
    {"channel": 3, "voltage_v": 12.5, "current_a": 2.125, "ovp_v": 13.0},
]


def section(address: str, **changes: object) -> SupplySection:
    data = {"address": address, "timeout_ms": 300.0, "channels": CHANNELS} | changes
    found, faults = validate(SupplySection, data)
    assert found is not None, faults
    return found


@pytest.fixture
def server():
    with SupplyServer() as running:
        yield running


@pytest.fixture
def supply(server):
    opened = Supply(section(server.address))
    yield opened
    server.inject(None)
    opened.close()


def test_what_is_set_is_what_the_supply_holds_and_reads_back(server, supply):
    supply.configure()
    first, second, third, fourth = server.model.outputs
    assert (first.voltage, first.current, first.ovp, first.ovp_on, first.fuse_on) == (24.0, 9.0, 26.0, True, True)
    assert (third.voltage, third.current, third.ovp) == (12.5, 2.125, 13.0)
    assert not second.selected
    assert not fourth.selected
    assert supply.find_differences() == []
    assert not supply.is_on, "setting switches nothing on"


def test_only_channels_of_the_rig_file_follow_the_switch_and_give_what_their_load_takes(server, supply):
    server.model.outputs[1].selected = True  # as someone left it at the front
    supply.configure()
    supply.switch_on()
    assert server.model.on == (True, False, True, False)
    one, three = supply.read_back()
    assert (one.measured_voltage, one.measured_current) == (24.0, 4.0)
    assert three.measured_voltage == pytest.approx(12.5)
    supply.switch_off()
    assert server.model.on == (False,) * 4
    assert supply.read_back()[0].measured_voltage == 0.0


def test_protection_is_set_before_the_voltage_that_it_guards(server):
    heard: list[str] = []
    answer = server.model.answer
    server.model.answer = lambda line: (heard.append(line.strip()), answer(line))[1]
    supply = Supply(section(server.address))
    supply.configure()
    settings = [line for line in heard if line.startswith(("VOLT", "INST"))]
    for number in ("1", "3"):
        began = settings.index(f"INST:NSEL {number}")
        guarded = next(i for i, line in enumerate(settings[began:]) if line == "VOLT:PROT 1")
        raised = next(i for i, line in enumerate(settings[began:]) if line.startswith("VOLT "))
        assert guarded < raised
    writes = [i for i, line in enumerate(heard) if "?" not in line]
    assert all(heard[i + 1] == "SYST:ERR?" for i in writes), "every setting is followed by a look for errors"
    supply.close()


def test_a_refused_setting_names_device_address_and_action(server):
    supply = Supply(section(server.address, channels=[CHANNELS[0] | {"voltage_v": 40.0, "ovp_v": 30.0 + 12.0}]))
    with pytest.raises(RigError) as caught:
        supply.configure()
    said = str(caught.value)
    assert f"127.0.0.1:{server.port}" in said
    assert "set channel 1 (amplifiers +x, -x) to 42 V of over-voltage protection" in said
    assert "-222, Data out of range" in said
    assert not any(server.model.on)
    supply.close()


def test_a_setting_that_did_not_stick_is_told(server, supply):
    supply.configure()
    server.model.outputs[2].current = 20.0  # a hand at the front panel
    server.model.outputs[0].ovp_on = False
    told = " ".join(supply.find_differences())
    assert "channel 3: current is 20 A, not 2.125 A" in told
    assert "channel 1 (amplifiers +x, -x): its over-voltage protection is off" in told


def test_errors_that_others_left_in_the_queue_are_not_ours(server):
    for _ in range(30):
        server.model.answer("NONSENSE 1")
    supply = Supply(section(server.address))
    supply.configure()
    supply.close()


@pytest.mark.parametrize("fault", ["off", "stalled", "garbled"])
@pytest.mark.parametrize("moment", ["opening", "setting", "switching on"])
def test_a_supply_that_fails_ends_within_its_deadline_and_is_named(server, fault, moment):
    if moment == "opening":
        server.inject(fault)
        with pytest.raises(RigError, match=f"power supply at 127.0.0.1:{server.port}: "):
            Supply(section(server.address))
        return
    supply = Supply(section(server.address))
    if moment == "switching on":
        supply.configure()
    server.inject(fault)
    act = supply.configure if moment == "setting" else supply.switch_on
    with pytest.raises(RigError, match=f"power supply at 127.0.0.1:{server.port}: cannot "):
        act()
    server.inject(None)
    supply.switch_off()  # a fresh connection: no late answer is taken for this one's
    assert server.model.on == (False,) * 4
    supply.close()


def test_another_model_is_refused_and_nothing_is_set(server):
    server.inject("wrong id")
    with pytest.raises(RigError, match=r"is a HAMEG HMP4040; the rig file says bench.supply.model = 'NGP8'"):
        Supply(section(server.address))
    assert server.model.outputs[0].voltage == 0.0


def test_a_model_with_too_few_channels_is_refused():
    with (
        SupplyServer(model=SupplyModel("NGP802")) as server,
        pytest.raises(RigError, match="NGP802 with 2 channels; the rig file sets 3"),
    ):
        Supply(section(server.address))


def test_nobody_listens_at_the_address():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"TCPIP::127.0.0.1::{free.getsockname()[1]}::SOCKET"
    with pytest.raises(RigError, match=r"power supply at 127\.0\.0\.1:\d+: cannot identify it: connection refused"):
        Supply(section(address))


def test_off_from_another_thread_wins_over_switching_on(server, supply):
    """Whatever the order in which both reach the supply, it ends off."""
    for _ in range(10):
        supply.configure()
        told: list[str] = []
        ready = threading.Barrier(2)

        def switch_on(ready: threading.Barrier = ready, told: list[str] = told) -> None:
            ready.wait()
            try:
                supply.switch_on()
            except RigError as error:
                told.append(str(error))

        other = threading.Thread(target=switch_on)
        other.start()
        ready.wait()
        supply.switch_off()
        other.join()
        assert not any(server.model.on)
        assert all("it was switched off since its channels were set" in said for said in told)


def test_it_is_not_switched_on_before_its_limits_are_set(server, supply):
    with pytest.raises(RigError, match="cannot switch the outputs on: its channels were not set"):
        supply.switch_on()
    supply.configure()
    supply.switch_off()
    with pytest.raises(RigError, match="switched off since"):
        supply.switch_on()
    assert not any(server.model.on)


def test_off_behind_a_stalled_exchange_ends_and_says_that_outputs_may_be_on(server, supply):
    supply.configure()
    supply.switch_on()
    server.inject("stalled")

    def ask() -> None:
        with pytest.raises(RigError):
            supply.read_back()

    asking = threading.Thread(target=ask)
    asking.start()
    with pytest.raises(RigError, match=r"switch the outputs off \(they may be on\): no answer within 300 ms"):
        supply.switch_off()
    asking.join()
    server.inject(None)
    supply.switch_off()
    supply.switch_off()
    assert not any(server.model.on)


def test_it_may_be_closed_again_and_again_and_leaves_all_off(server):
    supply = Supply(section(server.address))
    supply.configure()
    supply.switch_on()
    supply.close()
    supply.close()
    assert not any(server.model.on)


def test_the_fuse_and_the_over_voltage_protection_of_the_twin_cut_the_output_off():
    model = SupplyModel()
    for line in ("INST OUT2", "APPL 24,2", "FUSE ON", "OUTP:SEL 1", "OUTPut:GENeral:STATe ON"):
        assert model.answer(line) is None
    assert model.answer("FUSE:TRIP?") == "1", "24 V on 6 ohm asks for 4 A"
    assert model.answer("MEAS:CURR?") == "0.000"
    for line in ("FUSE 0", "VOLT:PROT:LEV 10", "VOLT:PROT ON", "outp:gen 1"):
        model.answer(line)
    assert model.answer("volt:prot:trip?") == "1", "2 A on 6 ohm are 12 V"
    assert model.answer("SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"address": "192.168.1.20"}, "must name a socket, such as TCPIP::192.168.1.20::5025::SOCKET"),
        ({"channels": [CHANNELS[0], CHANNELS[0]]}, "channel 1 is set twice"),
        ({"channels": [CHANNELS[0] | {"ovp_v": 24.0}]}, "ovp_v must lie above voltage_v = 24; got 24"),
        ({"channels": [CHANNELS[0] | {"channel": 5}]}, "less than or equal to 4"),
        ({"channels": [CHANNELS[0] | {"volts": 5}]}, "unknown key"),
    ],
)
def test_a_faulty_section_is_one_clear_error(tmp_path, changes, message):
    data = {"address": "TCPIP::127.0.0.1::5025::SOCKET", "channels": CHANNELS} | changes
    found, faults = validate(SupplySection, data, ("bench", "supply"))
    assert found is None
    assert message in Document(tmp_path / "rig.toml", "[bench.supply]\n").format_fault(faults[0])
