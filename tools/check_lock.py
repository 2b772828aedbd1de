"""Fail when requirements.lock no longer satisfies pyproject.toml (run by `make check`).

Resolving would need the package index, so this only compares the two files: a version in the lock must meet every
requirement of the project and of its development extra.
"""

import re
import sys
from pathlib import Path

from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def main() -> int:
    """Print each requirement that the lock does not meet."""
    lock: dict[str, set[str]] = {}
    for name, version in re.findall(r"(?m)^([\w.-]+)==(\S+)", Path("requirements.lock").read_text()):
        lock.setdefault(name.lower(), set()).add(version)
    unmet = []
    project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
    for text in [*project["dependencies"], *project["optional-dependencies"]["dev"]]:
        need = Requirement(text)
        if need.marker and not need.marker.evaluate():
            continue
        if not any(need.specifier.contains(version) for version in lock.get(need.name.lower(), ())):
            unmet.append(text)
    for text in unmet:
        print(f"requirements.lock does not meet {text!r}: run `make lock`")
    return 1 if unmet else 0


if __name__ == "__main__":
    sys.exit(main())
