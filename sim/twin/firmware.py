"""Build the magnet stage's firmware and the simulated board that runs it; both are cached."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from lookup_tables.cache import get_default_cache_dir
from smolbot.errors import RigError

CONTROLLER = "atmega328p"
FLAGS = ("-x", "c", "-std=gnu11", "-Os", "-flto", "-Wall", "-Wextra", "-Werror", f"-mmcu={CONTROLLER}")
BOARD_FLAGS = ("-O2", "-std=gnu11", "-Wall", "-Wextra")
LIBRARIES = ("-lsimavr", "-lelf", "-lutil")
PACKAGES = "gcc libc6-dev gcc-avr avr-libc simavr libsimavr-dev libelf-dev"
HEADERS = ("/usr/include/simavr/sim_avr.h", "/usr/local/include/simavr/sim_avr.h")


@dataclass(frozen=True)
class FirmwareBuild:
    """Paths of the compiled programs.

    Attributes
    ----------
    firmware : Path
        In ELF format.
    board : Path
        The program that simulates the board.
    """

    firmware: Path
    board: Path


def find_sketch() -> Path:
    """Return the firmware's source, as it is opened in the Arduino IDE.

    Returns
    -------
    Path
    """
    return Path(str(files("smolbot.bench.hardware"))) / "firmware" / "magnet_stage" / "magnet_stage.ino"


def find_missing_tools() -> str | None:
    """Find which tools for simulating the firmware are not installed.

    Returns
    -------
    str or None
        A message that names them; None if all are there.
    """
    lacking = [name for name in ("avr-gcc", "avr-size", "cc") if shutil.which(name) is None]
    if not any(Path(header).exists() for header in HEADERS):
        lacking.append("simavr's headers")
    if not lacking:
        return None
    return f"{', '.join(lacking)} not found; the firmware is simulated with the Debian packages {PACKAGES}"


def build_firmware(source: Path | None = None) -> FirmwareBuild:
    """Compile firmware and board, unless they are in the cache already.

    Parameters
    ----------
    source : Path, optional
        Of the firmware; the shipped one if not given.

    Returns
    -------
    FirmwareBuild

    Raises
    ------
    RigError
        If a tool is missing, or a compiler fails.
    """
    if (lack := find_missing_tools()) is not None:
        raise RigError(f"simulated magnet stage: {lack}.", device="magnet stage")
    source = find_sketch() if source is None else source
    harness = Path(str(files("sim.twin"))) / "avr" / "uno.c"
    digest = hashlib.sha256(repr((FLAGS, BOARD_FLAGS, LIBRARIES)).encode())
    for path in (source, harness):
        digest.update(path.read_bytes())
    folder = get_default_cache_dir() / "magnet_stage" / digest.hexdigest()[:16]
    built = FirmwareBuild(folder / "magnet_stage.elf", folder / "uno")
    if not (built.firmware.exists() and built.board.exists()):
        folder.mkdir(parents=True, exist_ok=True)
        _compile(["avr-gcc", *FLAGS, str(source)], built.firmware)
        _compile(["cc", *BOARD_FLAGS, str(harness)], built.board, LIBRARIES)
    return built


def measure_size(firmware: Path) -> tuple[int, int]:
    """Return the memory that a firmware uses.

    Parameters
    ----------
    firmware : Path

    Returns
    -------
    flash, ram : int, in bytes
        RAM without the stack.
    """
    listed = subprocess.run(["avr-size", "-A", str(firmware)], capture_output=True, text=True, check=True).stdout
    section = {name: int(count) for name, count in re.findall(r"^\.(\w+)\s+(\d+)", listed, re.M)}
    data = section.get("data", 0)
    return section["text"] + data, data + section.get("bss", 0) + section.get("noinit", 0)


def _compile(command: list[str], result: Path, libraries: tuple[str, ...] = ()) -> None:
    """Compile in a temporary folder, then move the result: parallel builds do not read partial files."""
    with tempfile.TemporaryDirectory(dir=result.parent) as aside:
        made = Path(aside) / result.name
        done = subprocess.run([*command, "-o", str(made), *libraries], capture_output=True, text=True)
        if done.returncode:
            raise RigError(
                f"simulated magnet stage: {command[0]} could not build {result.name}:\n{done.stderr}",
                device="magnet stage",
            )
        made.replace(result)
