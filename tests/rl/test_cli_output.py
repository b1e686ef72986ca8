"""What `cpgrl` prints where standard output takes little: another encoding, a full disk, nobody who reads."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cpgrl_opt.comparison.measurement import read_measurements
from rl.cli import main
from rl.experiments.json_file import write_summary

RECORDING = Path(__file__).parents[2] / "cpgrl_opt" / "comparison" / "recorded" / "arm.npz"
REPRODUCE = ["reproduce", "three-state", "--runs", "2", "--episodes", "20", "--steps", "20", "--jobs", "1"]
COMPARE = ["compare", "--quick", "--problems", "1", "--solvers", "active-set", "--jobs", "1"]
# The encodings of a Windows console and of a redirected stream in the C locale, with the errors that they come with.
STREAMS = [("cp1252", "strict"), ("ascii", "surrogateescape")]


def printed(arguments, encoding, errors, monkeypatch):
    """(exit code, standard output) of a command whose standard output has such an encoding."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors=errors)
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "argv", ["cpgrl", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    stream.flush()
    return ended.value.code, stream.buffer.getvalue().decode(encoding)


COMMANDS = [
    (["solvers"], "active-set", STREAMS[:1]),
    ([*REPRODUCE, "--out", "out"], "claims hold", STREAMS[1:]),
    (["export", RECORDING, "λ.parquet"], "?.parquet", STREAMS[1:]),
]


@pytest.mark.parametrize(
    ("arguments", "told", "stream"),
    [pytest.param(*case, stream, id=f"{case[0][0]}-{stream[0]}") for *case, streams in COMMANDS for stream in streams],
)
def test_every_command_prints_with_question_marks_for_what_the_encoding_lacks(
    arguments, told, stream, tmp_path, monkeypatch
):
    if arguments[0] == "export":
        pytest.importorskip("pyarrow")
    monkeypatch.setattr("rl.experiments.runner.draw", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    code, output = printed(arguments, *stream, monkeypatch)
    assert code == 0
    assert told in output
    assert "?" in output


C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "OMP_NUM_THREADS": "1"}


def run(*arguments, **options):
    command = [sys.executable, "-m", "rl.cli", *map(str, arguments)]
    return subprocess.run(command, timeout=300, check=False, stderr=subprocess.PIPE, **options)


@pytest.mark.skipif(os.name == "nt", reason="file names are text on Windows")
def test_names_that_the_locale_cannot_read_are_written_as_they_are(tmp_path):
    """In the C locale ψ comes as two surrogates, which no UTF-8 file takes."""
    (tmp_path / "ψ.npz").write_bytes(RECORDING.read_bytes())
    options = {"env": os.environ | C_LOCALE, "cwd": tmp_path, "stdout": subprocess.PIPE}
    compared = run(*COMPARE, "--families", "ψ.npz", "--out", "ω", **options)
    assert compared.returncode == 0, compared.stderr
    assert {each.family for each in read_measurements(tmp_path / "ω" / "measurements.csv")} == {"ψ.npz"}
    assert "ψ.npz" in (tmp_path / "ω" / "report.md").read_text(encoding="utf-8")


def test_a_summary_names_such_a_file_too(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["cpgrl", "--out", "ω".encode().decode("ascii", "surrogateescape")])
    write_summary(tmp_path / "summary.json", 1.0, {})
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["command"][-1] == "ω"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no disk that is always full")
def test_a_full_disk_is_one_line():
    with Path("/dev/full").open("w") as full:
        ended = run("--version", stdout=full)
    assert (ended.returncode, ended.stderr) == (2, b"cpgrl: [Errno 28] No space left on device\n")


@pytest.mark.parametrize("command", [["reproduce", "three-state"], ["sweep", "three-state"]])
def test_a_backend_that_there_is_none_of_is_told_before_the_training(command, tmp_path):
    options = {"env": os.environ | {"MPLBACKEND": "nope"}, "cwd": tmp_path, "stdout": subprocess.PIPE}
    ended = run(*command, "--jobs", "1", **options)
    assert (ended.returncode, ended.stderr.count(b"\n"), list(tmp_path.iterdir())) == (2, 1, [])
    assert b"'nope' is not a valid value for backend" in ended.stderr


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGPIPE")
def test_a_reader_that_left_ends_the_command_without_a_word():
    reading, writing = os.pipe()
    os.close(reading)
    ended = run("--version", stdout=writing)
    os.close(writing)
    assert (ended.returncode, ended.stderr) == (141, b"")


@pytest.mark.parametrize(("word", "code"), [("--version", 0), ("reproduc", 2)])
def test_closed_streams_are_no_error(word, code, monkeypatch):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    monkeypatch.setattr(sys, "argv", ["cpgrl", word])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
