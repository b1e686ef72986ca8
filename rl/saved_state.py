"""A tree of Python values and arrays in one file, whole or not at all: zip, with `state.json` and arrays as `.npy`.

NumPy's `load` opens it too. Nothing in it is unpickled or inflated when it is read.
"""

import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.comparison.whole_file import whole_file

_TEXT = "state.json"
_FORMAT = "cpgrl state 3"  # 3: settings as words and digests; 2: estimations carry drivers where 1 had rollouts
_OLDER = ("cpgrl state 1", "cpgrl state 2")  # which cannot be gone on from
_BEGINNING = (1980, 1, 1, 0, 0, 0)  # every entry's date, so that the same state makes the same bytes


def write_state(path: Path | str, kind: str, state: Mapping[str, Any]) -> None:
    """Puts the file in the path's place in one go, so that whenever the process ends there is a whole one, or none.

    state: None, bool, int, float, str, NumPy's numbers and arrays of numbers; lists, tuples and dicts (keys are
    strings) of these, ValueError for anything else. kind: what it is a state of.
    """
    arrays: list[np.ndarray] = []
    text = json.dumps({"format": _FORMAT, "kind": kind, "state": _pack(state, arrays, "state")})
    with whole_file(Path(path)) as part, part.open("wb") as file:
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(zipfile.ZipInfo(_TEXT, _BEGINNING), text)
            for index, array in enumerate(arrays):
                archive.writestr(zipfile.ZipInfo(f"{index}.npy", _BEGINNING), _bytes_of(array))
        file.flush()
        os.fsync(file.fileno())


def read_state(path: Path | str, kind: str) -> dict[str, Any]:
    """What `write_state` put there; ValueError with the reason for a file that is not there, damaged or another's."""
    try:
        with zipfile.ZipFile(path) as archive:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise ValueError("packed entries")
            contents = json.loads(archive.read(_TEXT))
            found = {name: contents.get(name) for name in ("format", "kind")}
            if found != {"format": _FORMAT, "kind": kind}:
                old = ", which an earlier version wrote and can go on from: begin anew, or install that one"
                why = old if found["format"] in _OLDER else ""
                raise ValueError(f"{found['kind']!r} of the format {found['format']!r}{why}")
            state = _unpack(contents["state"], lambda index: _array_of(archive.read(f"{int(index)}.npy")))
        if not isinstance(state, dict):
            raise ValueError(f"a state that is {type(state).__name__}")
    except FileNotFoundError:
        reason: object = "no such file"
    except Exception as error:  # zip, JSON and the parser of NumPy's headers may end in any of theirs
        reason = f"{error or type(error).__name__}"
    else:
        return state
    raise ValueError(f"{path} should be a {kind} of the format {_FORMAT!r}, whole; found {reason}")


def _pack(value: Any, arrays: list[np.ndarray], where: str) -> Any:
    """The value for JSON; arrays go to the list."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, (np.ndarray, np.generic)) and np.asarray(value).dtype.kind in "biufc":
        arrays.append(np.asarray(value))
        return {"array" if isinstance(value, np.ndarray) else "number": len(arrays) - 1}
    if type(value) in (list, tuple):
        return {type(value).__name__: [_pack(part, arrays, f"{where}[{k}]") for k, part in enumerate(value)]}
    if isinstance(value, Mapping) and all(type(key) is str for key in value):
        return {"dict": {key: _pack(part, arrays, f"{where}[{key!r}]") for key, part in value.items()}}
    raise ValueError(
        f"{where} should consist of None, numbers, strings, arrays of numbers, lists, tuples and dicts to be saved; "
        f"found {type(value).__name__}"
    )


def _unpack(value: Any, array_at: Any) -> Any:
    if not isinstance(value, dict):
        return value
    ((tag, content),) = value.items()
    if tag in ("array", "number"):
        return array_at(content) if tag == "array" else array_at(content)[()]
    if tag == "dict":
        return {key: _unpack(part, array_at) for key, part in content.items()}
    return {"list": list, "tuple": tuple}[tag](_unpack(part, array_at) for part in content)


def _bytes_of(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def _array_of(content: bytes) -> np.ndarray:
    array: np.ndarray = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    return array
