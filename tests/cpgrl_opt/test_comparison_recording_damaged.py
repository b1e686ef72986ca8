"""Whatever the bytes of a recording are, reading it gives a recording or a ValueError that names the file."""

import subprocess
import sys
import warnings
import zipfile
from io import BytesIO

import numpy as np
import pytest

from cpgrl_opt.comparison.recording import load_recording, shipped_recording

TINY = shipped_recording("three-state").select(slice(0, 6))


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    """{name of an array: its .npy} of a small recording."""
    path = tmp_path_factory.mktemp("recording") / "tiny.npz"
    TINY.save(path)
    with zipfile.ZipFile(path) as archive:
        return {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}


def packed(members):
    """The .npz of such a dictionary."""
    file = BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


def npy(array, shape=None, descr=None):
    """An array's .npy, with another shape or type in its header."""
    file = BytesIO()
    header = np.lib.format.header_data_from_array_1_0(array)
    header |= {"shape": array.shape if shape is None else shape, "descr": descr or header["descr"]}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + array.tobytes()


HEADERS = {
    "cut short": ({"gradient": npy(TINY.gradient)[:60]}, "gradient.npy that cannot be read"),
    "without axes": ({"gradient": npy(np.array(1.0))}, r"gradient should have 2 axes; found shape \(\)"),
    "of 8 TB": ({"gradient": npy(TINY.gradient, shape=(1_000_000, 1_000_000))}, "gradient.npy that cannot be read"),
    "of too little": ({"gradient": npy(TINY.gradient, shape=(1, 1))}, "more bytes than its header speaks of"),
    "of another type": ({"run": npy(TINY.run, descr="<f8")}, "run should be an array of int64; found float64"),
    "of objects": ({"run": npy(TINY.run, descr="|O")}, "run.npy that cannot be read"),
    "of numbers for text": ({"selection": npy(np.array(1.0))}, "selection should be text; found float64"),
    "of text that is no Unicode": ({"selection": npy(np.array("\ud800"))}, "codec can't decode"),
}


@pytest.mark.parametrize("header", HEADERS)
def test_a_header_that_fits_no_recording_is_refused(header, members, tmp_path):
    changes, what = HEADERS[header]
    path = tmp_path / "odd.npz"
    path.write_bytes(packed(members | changes))
    with pytest.raises(ValueError, match=rf"odd\.npz should .*{what}"):
        load_recording(path)


@pytest.mark.parametrize(
    ("name", "what"), [("other.npy", "what no recording has: 'other.npy'"), ("run.npy", "two entries of one name")]
)
def test_an_entry_that_is_no_part_of_a_recording_is_refused(name, what, members, tmp_path):
    path = tmp_path / "more.npz"
    path.write_bytes(packed(members))
    with zipfile.ZipFile(path, "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a name that is there already
        archive.writestr(name, members["run"])
    with pytest.raises(ValueError, match=rf"more\.npz should .*{what}"):
        load_recording(path)


def test_an_argument_that_old_numpy_stored_is_passed_over(members, tmp_path):
    path = tmp_path / "old.npz"
    path.write_bytes(packed(members))
    before = load_recording(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("allow_pickle.npy", b"whatever")  # never read
    assert len(load_recording(path)) == len(before)


def damaged(members, rng):
    """One of four: the file cut, some bytes of it changed, some bytes of an array changed, an entry gone."""
    manner = rng.integers(4)
    whole = bytearray(packed(members))
    if manner == 0:
        return bytes(whole[: rng.integers(len(whole))])
    if manner == 1:
        changed(whole, rng, len(whole))
        return bytes(whole)
    chosen = str(rng.choice(list(members)))
    if manner == 2:
        content = bytearray(members[chosen])
        changed(content, rng, 128 if chosen in ("run", "format") else len(content))  # within the header, or anywhere
        return packed(members | {chosen: bytes(content)})
    return packed({name: content for name, content in members.items() if name != chosen})


def changed(content, rng, end):
    for place in rng.integers(end, size=rng.integers(1, 9)):
        content[place] = rng.integers(256)


def test_damage_of_any_kind_ends_in_a_recording_or_in_a_value_error(members, tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.npz"
    refused = 0
    for _ in range(120):
        path.write_bytes(damaged(members, rng))
        try:
            assert len(load_recording(path)) == len(TINY)
        except ValueError as error:
            assert str(path) in str(error)  # noqa: PT017 - both outcomes are right
            refused += 1
    assert 60 < refused < 120


BOMB = """
import re, resource, sys
from pathlib import Path
from cpgrl_opt.comparison.recording import load_recording
size = int(re.search(r"VmSize:\\s+(\\d+)", Path("/proc/self/status").read_text()).group(1)) << 10
resource.setrlimit(resource.RLIMIT_AS, (size + (100 << 20),) * 2)
try:
    load_recording(sys.argv[1])
except ValueError as error:
    sys.exit(str(error))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and limits memory")
def test_a_small_file_that_unpacks_to_much_is_refused_in_little_memory(members, tmp_path):
    path = tmp_path / "bomb.npz"
    rows = 150_000
    path.write_bytes(packed(members | {"gradient": npy(np.zeros((rows, 125)))}))
    assert path.stat().st_size < 200_000
    command = [sys.executable, "-c", BOMB, str(path)]
    ended = subprocess.run(command, timeout=120, check=False, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 1
    assert ended.stderr.startswith(f"{path} should be a recording"), ended.stderr
    assert "bytes that unpack to" in ended.stderr
