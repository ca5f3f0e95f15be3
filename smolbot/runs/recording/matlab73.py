"""MATLAB files of version 7.3, for data too large for earlier versions: HDF5 with MATLAB's attributes.

As MATLAB writes them: a header of 512 bytes before the HDF5 file; arrays with their axes in reverse order; text as
16-bit characters; cells as references into ``#refs#``; structs as groups.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_HEADER = b"MATLAB 7.3 MAT-file, written by smolbot"
_USERBLOCK = 512
_NAMES = {"f": "double", "u": "uint8", "i": "int64", "b": "logical"}


def write_matlab73(path: Path, held: dict[str, Any]) -> None:
    """Write named arrays, numbers, text, lists (cell columns) and dictionaries (structs).

    Parameters
    ----------
    path : Path
    held : dict
        Values by name.
    """
    import h5py

    with h5py.File(path, "w", userblock_size=_USERBLOCK) as file:
        refs = file.create_group("#refs#")
        for name, value in held.items():
            _put(file, refs, name, value)
    with path.open("r+b") as raw:
        raw.write(_HEADER.ljust(116) + bytes(8) + b"\x00\x02IM")


def _put(group: Any, refs: Any, name: str, value: Any) -> None:
    import h5py

    if isinstance(value, dict):
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, part in value.items():
            _put(inner, refs, key, part)
        return
    if isinstance(value, list):
        places = []
        for part in value:
            place = f"r{len(refs)}"
            _put(refs, refs, place, part)
            places.append(refs[place].ref)
        if places:
            made = group.create_dataset(name, (1, len(places)), dtype=h5py.ref_dtype)
            made[0, :] = places
        else:
            made = _create_empty(group, name, (0, 1))
        made.attrs["MATLAB_class"] = np.bytes_("cell")
        return
    if isinstance(value, str):
        codes = np.frombuffer(value.encode("utf-16-le"), np.uint16)
        made = group.create_dataset(name, data=codes[:, None]) if len(codes) else _create_empty(group, name, (0, 0))
        made.attrs["MATLAB_class"] = np.bytes_("char")
        made.attrs["MATLAB_int_decode"] = np.int32(2)
        return
    array = np.asarray(value)
    kind = _NAMES[array.dtype.kind]
    array = array.reshape(-1, 1) if array.ndim < 2 else array
    stored = array.astype(np.uint8) if kind == "logical" else array
    made = _create_empty(group, name, array.shape) if not array.size else group.create_dataset(name, data=stored.T)
    made.attrs["MATLAB_class"] = np.bytes_(kind)
    if kind == "logical":
        made.attrs["MATLAB_int_decode"] = np.int32(1)


def _create_empty(group: Any, name: str, shape: tuple[int, ...]) -> Any:
    made = group.create_dataset(name, data=np.array(shape, np.uint64))
    made.attrs["MATLAB_empty"] = np.uint8(1)
    return made
