"""Reading the arrays of an `.npz` that somebody else may have made: nothing unpickled, nothing inflated unasked.

What the zip file's directory declares is looked at first, and arrays are read only if the whole of it fits. NumPy takes
the memory that an array's header speaks of, but the system gives none before it is written to.
"""

import sys
import zipfile
from collections.abc import Collection
from pathlib import Path

import numpy as np

_SUFFIX = ".npy"
_OF_OLD_NUMPY = "allow_pickle.npy"  # an argument that NumPy before 2.2 stored as an array, in recordings of that time
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what NumPy writes; others may ask for any memory to unpack
# Deflate packs zeros 1 : 1032, so that a file of 2 MB may hold 2 GB. Gradients of training pack about 1 : 2, whole
# recordings with their columns of counts 1 : 3; a hundred leaves room for gradients that are nearly all zero.
_MOST_PACKED = 100
_ALWAYS_ALLOWED = 1 << 26  # bytes: what is small may be packed as it likes
_UNICODE = "utf-32-le" if sys.byteorder == "little" else "utf-32-be"


def read_arrays(path: Path, names: Collection[str], optional: Collection[str] = ()) -> dict[str, np.ndarray]:
    """The arrays of the `.npz` of these names, whatever its bytes are; of the optional ones those that are there.

    Raises ValueError, with the path and what is wrong, for a file that is damaged or holds anything else.
    """
    try:
        size = path.stat().st_size
        with zipfile.ZipFile(path) as archive:
            entries = _entries(archive, names, optional)
            declared = sum(entry.file_size for entry in entries.values())
            if declared > max(_ALWAYS_ALLOWED, _MOST_PACKED * size):
                raise ValueError(f"{size} bytes that unpack to {declared}")
            return {name: _array(archive, entry) for name, entry in entries.items()}
    except FileNotFoundError:
        reason: object = "no such file"
    except Exception as error:  # zip file, stream, NumPy and Python's parser of headers raise what they like
        reason = error
    raise ValueError(f"{path} should be a recording, an .npz as --record writes it; found {reason}")


def _entries(archive: zipfile.ZipFile, names: Collection[str], optional: Collection[str]) -> dict[str, zipfile.ZipInfo]:
    """The entries of the directory by their arrays' names."""
    entries = {entry.filename: entry for entry in archive.infolist()}
    if len(entries) < len(archive.infolist()):
        raise ValueError("two entries of one name")
    entries.pop(_OF_OLD_NUMPY, None)
    wanted = {name: name + _SUFFIX for name in names}
    strange = [name for name in entries if name not in wanted.values()]
    if strange:
        raise ValueError(f"what no recording has: {', '.join(map(ascii, strange[:9]))}")
    wanted = {name: entry for name, entry in wanted.items() if entry in entries or name not in optional}
    missing = [name for name, entry in wanted.items() if entry not in entries]
    if missing:
        raise ValueError(f"no array named {', '.join(missing)}")
    if any(entry.compress_type not in _METHODS for entry in entries.values()):
        raise ValueError("a compression that NumPy does not write")
    return {name: entries[entry] for name, entry in wanted.items()}


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    try:
        with archive.open(entry) as stream:
            array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
            rest = stream.read(1)
    except Exception as error:
        raise ValueError(f"{entry.filename} that cannot be read ({error})") from error
    if rest:
        raise ValueError(f"{entry.filename} with more bytes than its header speaks of")
    if array.dtype.kind == "U":
        array.tobytes().decode(_UNICODE)  # NumPy lets any number pass for a character, and Python ends in SystemError
    return array
