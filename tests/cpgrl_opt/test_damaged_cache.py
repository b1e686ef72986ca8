"""A cache of numba's that a full disk or a killed process left damaged costs a compilation, and no answer."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

WORK = textwrap.dedent(
    """
    import os, sys
    from cpgrl_opt.machine_code import compiled
    def twice(x):
        return 2.0 * x
    print(compiled("f8(f8)", twice)(21.0))
    """
)


def answered(folder: Path) -> str:
    (folder / "work.py").write_text(WORK, encoding="utf-8")
    environment = {"NUMBA_CACHE_DIR": str(folder / "cache"), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    run = subprocess.run(
        [sys.executable, str(folder / "work.py")], env=environment, capture_output=True, text=True, check=True
    )
    return run.stdout.strip()


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda _: b"", lambda _: b"no pickle at all"])
def test_a_damaged_cache_is_made_anew(tmp_path: Path, damage: object) -> None:
    assert answered(tmp_path) == "42.0"
    for suffix in ("nbi", "nbc"):
        files = list((tmp_path / "cache").rglob(f"*.{suffix}"))
        assert files
        for file in files:
            file.write_bytes(damage(file.read_bytes()))  # type: ignore[operator]
        assert answered(tmp_path) == "42.0"
    whole = {file.name: file.read_bytes() for file in (tmp_path / "cache").rglob("*.nb?")}
    assert answered(tmp_path) == "42.0"
    assert {file.name: file.read_bytes() for file in (tmp_path / "cache").rglob("*.nb?")} == whole
