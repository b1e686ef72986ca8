"""Results say what kind of machine made a result, and not which one."""

import platform
from pathlib import Path

from cpgrl_opt.comparison import machine


def test_the_machine_is_told_without_its_kernels_release():
    told = machine.machine()
    assert set(told) == {"system", "machine", "processor", "cores"}
    assert told["system"] == platform.system()
    assert platform.release() not in " ".join(map(str, told.values()))


def test_the_processors_model_is_read_where_the_system_tells_it(tmp_path, monkeypatch):
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Fast One\nmodel name\t: Other\n", encoding="utf-8")
    monkeypatch.setattr(machine, "_CPUINFO", tmp_path / "cpuinfo")
    assert machine.machine()["processor"] == "Fast One"


def test_a_system_that_does_not_tell_is_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "_CPUINFO", Path(tmp_path / "none"))
    assert machine.machine()["processor"]
