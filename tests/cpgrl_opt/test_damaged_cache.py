"""A cache of numba's that a full disk or a killed process left damaged costs a compilation, and no answer."""

from pathlib import Path

import numba
import pytest

from cpgrl_opt.machine_code import compile_function

SOURCE = "def twice(x):\n    return 2.0 * x\n"


def answer(folder: Path) -> float:
    """As a new process would: another function of the same source, which finds what is in the cache."""
    names: dict[str, object] = {}
    exec(compile(SOURCE, str(folder / "work.py"), "exec"), names)
    return compile_function("f8(f8)", names["twice"])(21.0)  # type: ignore[arg-type, no-any-return]


def cached(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in (folder / "cache").rglob("*.nb?")}


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda _: b"", lambda _: b"no pickle at all"])
def test_a_damaged_cache_is_made_anew(tmp_path: Path, damage: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "work.py").write_text(SOURCE, encoding="utf-8")
    assert answer(tmp_path) == 42.0
    for suffix in ("nbi", "nbc"):
        files = list((tmp_path / "cache").rglob(f"*.{suffix}"))
        assert files
        for file in files:
            file.write_bytes(damage(file.read_bytes()))  # type: ignore[operator]
        assert answer(tmp_path) == 42.0
    whole = cached(tmp_path)
    assert answer(tmp_path) == 42.0
    assert cached(tmp_path) == whole
