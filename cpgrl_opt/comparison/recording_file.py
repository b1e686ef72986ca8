"""Reading the arrays of an `.npz` that somebody else may have made: nothing unpickled, nothing inflated unasked.

What the zip file's directory and the arrays' headers declare is looked at first, and arrays are read only if the whole
of it fits: the names, the types, the numbers of axes, and the bytes.
"""

import math
import sys
import zipfile
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_SUFFIX = ".npy"
_OF_OLD_NUMPY = "allow_pickle.npy"  # an argument that NumPy before 2.2 stored as an array, in recordings of that time
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what NumPy writes; others may ask for any memory to unpack
# Deflate packs zeros 1 : 1032, so that a file of 2 MB may hold 2 GB. Gradients of training pack about 1 : 2, whole
# recordings with their columns of counts 1 : 3; a hundred leaves room for gradients that are nearly all zero.
_MOST_PACKED = 100
_ALWAYS_ALLOWED = 1 << 26  # bytes: what is small may be packed as it likes
_MOST_TEXT = 1 << 20  # bytes
_UNICODE = "utf-32-le" if sys.byteorder == "little" else "utf-32-be"
# What the zip file and the stream under it raise where bytes are wrong or missing.
_DAMAGED = (
    OSError, EOFError, ValueError, KeyError, IndexError, OverflowError, NotImplementedError, RuntimeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """What an array should be. types: the characters of NumPy's dtypes, such as "f8"; axes: how many it may have."""

    types: str
    axes: tuple[int, ...]


def read_arrays(path: Path, kinds: Mapping[str, Kind], optional: Collection[str] = ()) -> dict[str, np.ndarray]:
    """The arrays of the `.npz`, one for each kind, whatever its bytes are; of the optional ones those that are there.

    Raises ValueError, with the path and what is wrong, for a file that is damaged or holds anything else.
    """
    try:
        size = path.stat().st_size
        with zipfile.ZipFile(path) as archive:
            entries = _entries(archive, kinds, optional)
            declared = sum(entry.file_size for entry in entries.values())
            if declared > max(_ALWAYS_ALLOWED, _MOST_PACKED * size):
                raise ValueError(f"{size} bytes that unpack to {declared}")
            for name, entry in entries.items():
                _require_header(archive, entry, name, kinds[name])
            return {name: _array(archive, entry) for name, entry in entries.items()}
    except FileNotFoundError:
        reason: object = "no such file"
    except _DAMAGED as error:
        reason = error
    raise ValueError(f"{path} should be a recording, an .npz as --record writes it; found {reason}")


def _entries(
    archive: zipfile.ZipFile, kinds: Mapping[str, Kind], optional: Collection[str]
) -> dict[str, zipfile.ZipInfo]:
    """The entries of the directory by their arrays' names, in the order of the kinds."""
    entries = {entry.filename: entry for entry in archive.infolist()}
    if len(entries) < len(archive.infolist()):
        raise ValueError("two entries of one name")
    entries.pop(_OF_OLD_NUMPY, None)
    wanted = {name: name + _SUFFIX for name in kinds}
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


def _require_header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str, kind: Kind) -> None:
    with archive.open(entry) as stream:
        try:
            version = np.lib.format.read_magic(stream)
            if version not in ((1, 0), (2, 0)):
                raise ValueError(f"version {version}")
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
        except Exception as error:  # Python's parser reads the header, and may end in any of its errors
            raise ValueError(f"{name} without a header that can be read ({error})") from error
        begin = stream.tell()
    shape = tuple(map(int, shape))
    if (dtype.str[1:] if dtype.kind != "U" else "U") not in kind.types.split() or not dtype.isnative:
        raise ValueError(f"{name} of type {dtype}")
    if len(shape) not in kind.axes or min(shape, default=0) < 0:
        raise ValueError(f"{name} of shape {shape}")
    asked = math.prod(shape) * dtype.itemsize
    if begin + asked != entry.file_size:
        raise ValueError(f"{name} whose header speaks of {asked} bytes, in an entry of {entry.file_size - begin}")
    if dtype.kind == "U" and asked > _MOST_TEXT:
        raise ValueError(f"{asked} bytes of text in {name}")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(entry) as stream:
        array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
    if array.dtype.kind == "U":
        array.tobytes().decode(_UNICODE)  # NumPy lets any number pass for a character, and Python ends in SystemError
    return array
