"""The application: a camera's frames in, velocity setpoints to an autopilot out.

`loop` shows the whole data flow on one screen; `messages`, `geometry` and `ranges` are what every room speaks.
Imports run one way: camera, link, control <- safety <- operator, recording <- flight <- cli; `config` gathers the
settings of all rooms for the command line.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str


def __getattr__(name: str) -> Any:
    if name != "__version__":
        raise AttributeError(f"module 'follow' has no attribute {name!r}")
    import racf  # noqa: PLC0415 - only when it is used

    return racf.__version__
