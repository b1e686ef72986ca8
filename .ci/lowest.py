"""Prints the lowest version that pyproject.toml allows of each dependency, extras included, as pip's constraints."""

import sys
import tomllib
from itertools import chain
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))["project"]


def lowest(requirement: Requirement) -> str:
    """name==version, of the bound name>=version."""
    [version] = [bound.version for bound in requirement.specifier if bound.operator == ">="]
    return f"{requirement.name}=={version}"


for line in chain(PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()):
    if (requirement := Requirement(line)).name != PROJECT["name"]:  # an extra that names other extras
        sys.stdout.write(f"{lowest(requirement)}\n")
