"""Old import paths, which work for one more release, each with a warning that names the new one.

To add an old path, add a row to `MOVED`. A row without an object covers all names of a module.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from opcode import opname
from types import ModuleType
from typing import Any

MOVED = {
    # documented under the path of its module before it had a public path
    "smolbot.runs.run:CycleRecord": "smolbot.runs:CycleRecord",
    "smolbot.runs.run:Event": "smolbot.runs:Event",
    "smolbot.runs.recording.reader:RecordedRun": "smolbot.runs:RecordedRun",
    "smolbot.runs.recording.reader:Played": "smolbot.runs:PlayedShot",
    "smolbot.runs.recording.converter:Converter": "smolbot.runs:Converter",
    "smolbot.runs.recording.files:RunFiles": "smolbot.runs:RunFiles",
    "smolbot.runs.trace:Moment": "smolbot.runs:Moment",
    "smolbot.runs.trace:Trace": "smolbot.runs:Trace",
    "smolbot.flight.replay:Replay": "smolbot.flight:Replay",
    "smolbot.flight.pilots:Pilot": "smolbot.flight:Pilot",
    "smolbot.flight.tracking.tracker:Oscillation": "smolbot.localization:Oscillation",
    "smolbot.paths.speed_profile:SpeedProfile": "smolbot.paths:SpeedProfile",
    "smolbot.config.world:World": "smolbot.config:World",
    "smolbot.config.rig:RigConfig": "smolbot.config:RigConfig",
    "smolbot.config.robot:RobotConfig": "smolbot.config:RobotConfig",
    "smolbot.config.robot:load_robot": "smolbot:load_robot",
    "smolbot.config.library:find_file": "smolbot.config:find_file",
    "smolbot.config.document:Document": "smolbot.config:Document",
    "smolbot.config.document:Fault": "smolbot.config:Fault",
    "smolbot.config.sensors:CalibratedSensors": "smolbot.config:CalibratedSensors",
    "smolbot.motion.controller:Cycle": "smolbot.motion:Cycle",
    "smolbot.motion.controller:HelixSetup": "smolbot.motion:HelixSetup",
    "smolbot.motion.controller:Reach": "smolbot.motion:ForceProfile",
    "smolbot.motion.controller:complete_gains": "smolbot.motion:complete_gains",
    "smolbot.motion.robot:Robot": "smolbot.motion:Robot",
    "smolbot.motion.helix:Helix": "smolbot.motion:Helix",
    "smolbot.motion.led:Motion": "smolbot.motion:ExternalMotion",
    "smolbot.core.operator:Operator": "smolbot.core:Operator",
    "smolbot.core.coil_heat:Coil": "smolbot.core:ThermalCoil",
    "smolbot.core.arrays:FloatArray": "smolbot.core:FloatArray",
    "smolbot.core.arrays:BoolArray": "smolbot.core:BoolArray",
    "smolbot.localization.localizer:Swing": "smolbot.localization:Swing",
    "smolbot.localization.problem:Problem": "smolbot.localization:Problem",
    "smolbot.localization.problem:Fit": "smolbot.localization:Fit",
    "smolbot.localization.noise.actuation_tails": "smolbot.localization.noise.actuation_decay",
    "smolbot.motion.kernels:_rolled": "smolbot.motion.kernels:_simulate_with_derivatives",
    "sim.tank.world:TankWorld": "sim:TankWorld",
    "lookup_tables.coils:Coil": "lookup_tables:Coil",
    # documented before modules moved into rooms
    "smolbot.poses": "smolbot.core.pose",
    "smolbot.flown:CycleRecord": "smolbot.runs:CycleRecord",
    "smolbot.flown:Event": "smolbot.runs:Event",
    "smolbot.recording.reader:RecordedRun": "smolbot.runs:RecordedRun",
    "smolbot.recording.reader:Played": "smolbot.runs:PlayedShot",
    "smolbot.recording.converter:Converter": "smolbot.runs:Converter",
    "smolbot.recording.files:RunFiles": "smolbot.runs:RunFiles",
    "smolbot.records.trace:Moment": "smolbot.runs:Moment",
    "smolbot.records.trace:Trace": "smolbot.runs:Trace",
    "smolbot.replaying:Replay": "smolbot.flight:Replay",
    "smolbot.speeds:SpeedProfile": "smolbot.paths:SpeedProfile",
    "smolbot.pilots:Pilot": "smolbot.flight:Pilot",
    "smolbot.plugins:World": "smolbot.config:World",
    "smolbot.control:Cycle": "smolbot.motion:Cycle",
    "smolbot.control:HelixSetup": "smolbot.motion:HelixSetup",
    "smolbot.control:Reach": "smolbot.motion:ForceProfile",
    "smolbot.control:complete_gains": "smolbot.motion:complete_gains",
    "smolbot.rigfile:RigConfig": "smolbot.config:RigConfig",
    "smolbot.robotfile:RobotConfig": "smolbot.config:RobotConfig",
    "smolbot.robotfile:load_robot": "smolbot:load_robot",
    "smolbot.library:find_file": "smolbot.config:find_file",
    "smolbot.operator:Operator": "smolbot.core:Operator",
    "smolbot.watching:Motion": "smolbot.motion:ExternalMotion",
    "smolbot.tracking:Oscillation": "smolbot.localization:Oscillation",
    "smolbot.sensorsfile:CalibratedSensors": "smolbot.config:CalibratedSensors",
    "smolbot.heat:Coil": "smolbot.core:ThermalCoil",
    "smolbot.arrays:FloatArray": "smolbot.core:FloatArray",
    "smolbot.arrays:BoolArray": "smolbot.core:BoolArray",
    "smolbot.hardware.stage": "smolbot.bench.hardware.stage",
    "sim.world:TankWorld": "sim:TankWorld",
}
"""Old path and new one, ``module:name`` each."""

_OURS = ("smolbot", "controllers", "lookup_tables", "sim")
_NAMING_OPCODES = ("IMPORT_FROM", "LOAD_ATTR", "LOAD_METHOD")  # not a lookup by pickle, which has the old path only
_MODULES = {old.partition(":")[0] for old in MOVED}


class _OldPath(ModuleType):
    """A module that moved in full or in part: another package that uses an old path of it gets a warning."""

    def __getattribute__(self, name: str) -> Any:
        names = ModuleType.__getattribute__(self, "__dict__")
        module = names["__name__"]
        new = MOVED.get(f"{module}:{name}")
        if new is None and module in MOVED and name not in names and not name.startswith("__"):
            new = f"{MOVED[module]}:{name}"
        if new is None:
            return ModuleType.__getattribute__(self, name)
        caller = sys._getframe(1)
        importer = caller.f_globals.get("__name__")
        package = str(caller.f_globals.get("__package__") or importer)  # our own programs are named __main__
        is_named = opname[caller.f_code.co_code[caller.f_lasti]] in _NAMING_OPCODES
        gone = name not in names and importer != "importlib._bootstrap"  # which only tests for the name
        if gone or (is_named and package.partition(".")[0] not in _OURS):
            message = f"{module}.{name} is now {new.replace(':', '.')}; the old path ends with the next release."
            warnings.warn(message, DeprecationWarning, stacklevel=2)
        return names[name] if name in names else _find(new)


class _EmptyLoader(Loader):
    """Loads a module that no longer exists and has old paths only."""

    def exec_module(self, module: ModuleType) -> None:
        module.__class__ = _OldPath


class _WatchingLoader(SourceFileLoader):
    """Loads a module that still exists, and makes its old paths warn."""

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        module.__class__ = _OldPath


class _Finder(MetaPathFinder):
    """Finds the modules of `MOVED`, whether or not they still exist, and the packages that held them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        is_parent = any(module.startswith(f"{fullname}.") for module in _MODULES)
        if "." not in fullname or not (fullname in _MODULES or is_parent):
            return None
        others = [finder for finder in sys.meta_path if finder is not self]  # an editable install has one of its own
        found = next((spec for finder in others if (spec := finder.find_spec(fullname, path, target))), None)
        if found is None:
            return ModuleSpec(fullname, _EmptyLoader(), is_package=is_parent)
        if fullname in _MODULES and found.origin is not None:
            found.loader = _WatchingLoader(fullname, found.origin)
        return found


def _find(path: str) -> Any:
    """Import the object at a new path of `MOVED`."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def install() -> None:
    """Make old paths importable, also those of modules that are already loaded; safe to repeat."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
    for loaded in _MODULES & sys.modules.keys():
        sys.modules[loaded].__class__ = _OldPath
