"""Links: everything that gives the vehicle's state and takes setpoints, behind the `Link` seam.

`client` is MAVLink without I/O (bytes in, state out); `transports` and `mavsdk_transport` carry the bytes; `replay`
is a simple vehicle for recorded footage.  May import: messages, geometry, ranges.
"""

from follow.link.seam import Link, LinkError

__all__ = ["Link", "LinkError"]
