"""Cameras: everything that yields frames behind the `Camera` seam (files, devices, streams, a window over footage).

May import: messages, geometry, ranges and the tracker's library.  All that it knows of a vehicle is a VehicleState.
"""

from follow.camera.seam import Camera, CameraError

__all__ = ["Camera", "CameraError"]
