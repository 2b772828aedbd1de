"""The Link seam: gives the vehicle's state and takes setpoints."""

from types import TracebackType
from typing import Protocol

from typing_extensions import Self

from follow.messages import Setpoint, VehicleState


class Link(Protocol):
    """A connection to one vehicle.  Leaving the `with` block makes the vehicle hover and closes the connection."""

    def state(self) -> VehicleState:
        """What is known of the vehicle now; never blocks.  Its `t_s` is the loop's only clock."""
        ...

    def send(self, setpoint: Setpoint | None) -> None:
        """Hand one setpoint to the autopilot at once, or nothing when None (the stream stops).

        Raises ValueError for a setpoint that is not finite.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class LinkError(RuntimeError):
    """The connection cannot be opened, or it broke.  The message is one sentence for a person."""
