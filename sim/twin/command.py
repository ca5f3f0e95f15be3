"""``smolbot twin``: a bench without hardware, for the programs that would use one."""

from __future__ import annotations

import signal
import sys
import threading
from typing import Annotated

import numpy as np
import typer

from smolbot.ui.cli.show import echo_json, print_table

POLL = 0.2
"""Time, in s, between two checks whether the tank has failed."""

HARDWARE_STOP = 3
"""Exit code of a hardware or interlock stop."""


def twin(
    mission: Annotated[
        str, typer.Argument(help="Mission at whose start its robot is placed.", metavar="MISSION")
    ] = "r_path",
    rig: Annotated[
        str | None, typer.Option(help="Twin of a bench; default: twin, or twin_gel for a helical robot.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the tank and its noise.")] = 1,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME@MOMENT[:once|good], such as overrun@listening#30 or button@12.5s; see --list-faults."),
    ] = None,
    list_faults: Annotated[bool, typer.Option("--list-faults", help="List the faults by name and exit.")] = False,
    control: Annotated[
        str, typer.Option(help="Address (host:port) of the control server, for faults.")
    ] = "127.0.0.1:31765",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object when all servers listen.")] = False,
) -> None:
    """Simulate a bench: NI card behind a device server, magnet stage behind a serial port, and the tank."""
    from sim.twin.faults import FAULTS, parse_fault

    if list_faults:
        print_table("faults of the twin", list(FAULTS.items()), err=json)
        if json:
            echo_json(FAULTS)
        return
    from sim.twin.twin import Twin
    from smolbot.bench.hardware.priority import raise_priority
    from smolbot.config.load import load_mission
    from smolbot.config.observation import Observation
    from smolbot.core.thread_switching import SWITCH_INTERVAL

    faults = [parse_fault(text) for text in fault or []]
    loaded = load_mission(mission, rig) if rig is not None else load_mission(mission, _find_twin(mission))
    place = loaded.start if isinstance(loaded, Observation) else loaded.start_placement
    end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end.set())
    raise_priority()
    sys.setswitchinterval(SWITCH_INTERVAL)
    running = Twin(loaded.rig, loaded.robot, np.array(place), seed, control=control)
    try:
        for one in faults:
            running.inject(one)
        section = running.section
        rows = [
            ("card", f"{section.product} '{section.device}' behind a device server at {section.server}"),
            ("magnet stage", f"serial port {section.stage.port}" if section.stage else "none"),
            ("truth", f"at {section.truth}, for recorder and report"),
            ("control", f"at 127.0.0.1:{running.control.port}, for faults"),
            ("tank", f"robot '{loaded.robot.name}' at the start of '{loaded.name}', seed {seed}"),
            ("to use it", f"smolbot run {mission} --rig {loaded.rig.name}"),
            ("to end it", "Ctrl-C"),
        ]
        print_table(f"twin of {loaded.rig.name}", rows, err=json)
        if json:
            echo_json(
                {
                    "server": section.server,
                    "truth": section.truth,
                    "control": f"127.0.0.1:{running.control.port}",
                    "stage": section.stage.port if section.stage else None,
                    "seed": seed,
                }
            )
        while not end.wait(POLL):
            if running.card.failure is not None:
                typer.echo(f"The tank has ended: {running.card.failure}", err=True)
                raise typer.Exit(HARDWARE_STOP)
    finally:
        running.close()


def _find_twin(mission: str) -> str:
    from smolbot.config.load import load_mission

    return "twin_gel" if load_mission(mission, None).robot.kind == "helical" else "twin"
