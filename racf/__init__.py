"""RACF: residue-aware correlation filters with GrabCut scale refinement (Li et al. 2021), as a library.

Names are loaded on first use, so that `import racf` stays quick.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from racf.box import Box as Box
    from racf.track import Track as Track

__all__ = ["Box", "Track"]

_HOME = {"Box": "racf.box", "Track": "racf.track"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'racf' has no attribute {name!r}")
    import importlib  # noqa: PLC0415 - only when a name is asked for

    return getattr(importlib.import_module(_HOME[name]), name)
