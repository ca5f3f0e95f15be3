"""A kernel that is compiled for two signatures makes the first flight wait twice for it."""

from __future__ import annotations

import subprocess
import sys

FLIGHTS = """
import sys, tempfile
import smolbot
from numba.core.registry import CPUDispatcher

with tempfile.TemporaryDirectory() as folder:
    for mission in sys.argv[1:]:
        out = folder + "/" + mission
        smolbot.run(mission, out=out, report=False, force="preview", stop__max_duration_s=1.0,
                    localization__quiet_s=1.0)
seen = {}
for name, module in list(sys.modules.items()):
    if name.split(".")[0] in ("smolbot", "sim", "controllers", "lookup_tables"):
        seen |= {v: v.signatures for v in vars(module).values() if isinstance(v, CPUDispatcher)}
print(sum(len(s) == 1 for s in seen.values()))
for kernel, signatures in seen.items():
    if len(signatures) > 1:
        print(kernel.py_func.__module__, kernel.py_func.__name__, *signatures, sep="\\n    ")
"""


def test_flights_compile_each_kernel_for_one_signature():
    told = subprocess.run(
        [sys.executable, "-c", FLIGHTS, "line", "s_path"], capture_output=True, text=True, check=True, timeout=300
    )
    compiled, *twice = told.stdout.split("\n", 1)
    assert not "".join(twice).strip(), twice
    assert int(compiled.split()[-1]) > 20
