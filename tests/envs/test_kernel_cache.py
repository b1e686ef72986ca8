"""Kernels cached before a source changed are compiled anew; a cache that cannot be changed is used as it is."""

import os
from pathlib import Path

import pytest

from envs.interface import random_stream
from envs.interface.kernel_cache import forget_outdated_kernels


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "__pycache__").mkdir()
    for name, age in (("helper.py", 100), ("__pycache__/entry.nbi", 50), ("__pycache__/older.nbi", 150)):
        (tmp_path / name).write_text("", encoding="utf-8")
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    return tmp_path


def cached(folder):
    return {path.name for path in (folder / "__pycache__").iterdir()}


def test_only_what_is_older_than_a_source_is_forgotten_wherever_that_is(folder, tmp_path_factory):
    forget_outdated_kernels([folder], [folder / "helper.py"])
    assert cached(folder) == {"entry.nbi"}
    helper = tmp_path_factory.mktemp("elsewhere") / "helper.py"
    helper.write_text("", encoding="utf-8")
    forget_outdated_kernels([folder], [folder / "helper.py", helper])
    assert cached(folder) == set()


def test_a_cache_that_cannot_be_changed_is_used_as_it_is(folder, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError("read-only")

    monkeypatch.setattr(Path, "unlink", refuse)
    forget_outdated_kernels([folder], [folder / "helper.py"])
    assert cached(folder) == {"entry.nbi", "older.nbi"}


def test_rl_watches_every_file_that_its_kernels_may_hold_code_of():
    import rl
    from envs import interface
    from rl._kernels import _FOLDERS, _sources

    sources = {source.resolve() for source in _sources()}
    for package, folder in ((interface, ""), (rl, "policies"), (rl, "drivers"), (rl, "estimators")):
        assert set((Path(package.__file__).parent / folder).resolve().glob("*.py")) <= sources
    with_kernels = {path.parent for path in Path(rl.__file__).parent.rglob("*.py") if "\n@kernel(" in path.read_text()}
    assert with_kernels == set(_FOLDERS)


def test_envs_watches_every_file_that_its_kernels_may_hold_code_of():
    import envs

    files = list(Path(envs.__file__).parent.rglob("*.py"))
    assert {path.parent for path in files if "\n@numba." in path.read_text(encoding="utf-8")} <= set(
        random_stream._FOLDERS
    )
    assert set(files) <= set(random_stream._SOURCES)
