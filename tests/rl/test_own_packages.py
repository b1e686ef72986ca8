"""A foreign `envs` in the way of ours is named, with what to do."""

import shutil
import subprocess
import sys
from pathlib import Path

import envs


def test_an_envs_of_somebody_else_is_named(tmp_path: Path) -> None:
    (tmp_path / "envs").mkdir()
    (tmp_path / "envs" / "__init__.py").touch()
    home = Path(envs.__file__).parents[1]
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(home)!r}]; import rl"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert f"should be that of cpgrl-opt, {home / 'envs'}; found {tmp_path / 'envs'}" in run.stderr


def test_an_envs_that_another_distribution_wrote_into_ours_is_named(tmp_path: Path) -> None:
    home = Path(envs.__file__).parents[1]
    for name in ("rl", "envs"):
        shutil.copytree(home / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "envs" / "__init__.py").write_text("from .base import Env\n", encoding="utf-8")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}]; import rl"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    told = " ".join(run.stderr.split())
    assert f"found {tmp_path / 'envs' / '__init__.py'}, which is not" in told
