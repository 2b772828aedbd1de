"""A ground station of your own, with MAVSDK: choose the target in the drone's image, read what is tracked, and stop.

    follow sim walker --ground udpin:127.0.0.1:14560 --ground-follows
    python examples/select_with_mavsdk.py udpout://127.0.0.1:14560 0.5,0.5

The second argument is a point, x,y, or a box, left,top,right,bottom, in fractions of the image from its top left; the
simulated walker is in the middle for the first seconds (`--page 127.0.0.1:8080` beside `--ground` shows the image).
Behind the autopilot (`--ground link`) connect as to the autopilot itself.  MAVSDK's Camera can select and stop, but
reports neither the tracking status nor why a selection is refused: both are read as MAVLink messages.  The example does
not sign its packets, so that a direct `follow run` accepts its selection only with `--ground-unsigned`.
"""

import json
import sys
import time
from queue import Empty, SimpleQueue
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.camera.camera import Camera, CameraError
from mavsdk.plugins.mavlink_direct import MavlinkDirect

FOUND_S = 20.0
ACTIVE = 1  # of CAMERA_TRACKING_STATUS_FLAGS: also while the target is hidden for a moment and its box is predicted
CORNERS = ("rec_top_x", "rec_top_y", "rec_bottom_x", "rec_bottom_y")


def find(mavsdk: Mavsdk, told: SimpleQueue[Any]) -> tuple[Camera, int]:
    """Our camera and its component id; its messages go to `told`.  Raises Empty if it does not come in time."""
    arrived, listed = SimpleQueue[bool](), SimpleQueue[Any]()
    mavsdk.subscribe_on_new_system(lambda _: arrived.put(True))
    if not mavsdk.system_count():
        arrived.get(timeout=FOUND_S)
    system = mavsdk.get_systems()[0]
    camera, direct = Camera(system), MavlinkDirect(system)
    for name in ("CAMERA_TRACKING_IMAGE_STATUS", "STATUSTEXT"):
        direct.subscribe_message(name, lambda message, _: told.put(message))
    camera.subscribe_camera_list(lambda found, _: listed.put(found.cameras))
    while not (ours := [one for one in listed.get(timeout=FOUND_S) if one.model_name == "RACF"]):
        pass  # skip the vehicle's other cameras
    return camera, ours[0].component_id


def show(told: SimpleQueue[Any], seconds: float) -> int:
    """Print the camera's messages for some seconds; returns in how many statuses a box was tracked."""
    tracked, end_s = 0, time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        try:
            message = told.get(timeout=left_s)
        except Empty:  # the camera sends no status while nothing is tracked
            break
        fields = json.loads(message.fields_json)
        if "text" in fields:
            print(fields["text"])
        elif fields["tracking_status"] == ACTIVE:
            tracked += 1
            print("tracked", *(f"{fields[corner]:.3f}" for corner in CORNERS))
        else:
            print("nothing is tracked")
    return tracked


def main(url: str, chosen: tuple[float, ...], seconds: float = 10.0) -> int:
    """Choose, show for some seconds what is tracked, and stop; returns in how many statuses a box was tracked."""
    log_subscribe(lambda *_: True)  # else MAVSDK prints its own log
    mavsdk, told = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)), SimpleQueue[Any]()
    try:
        mavsdk.add_any_connection(url)
        camera, component = find(mavsdk, told)
        try:
            if len(chosen) == 4:
                camera.track_rectangle(component, *chosen)
            else:
                camera.track_point(component, *chosen, 0.0)
        except CameraError:
            show(told, 1.0)  # the reason
            raise
        try:
            return show(told, seconds)
        finally:
            camera.track_stop(component)  # ends FOLLOW also
            show(told, 0.5)
    finally:
        mavsdk.destroy()


if __name__ == "__main__":
    try:
        numbers = tuple(map(float, sys.argv[2].split(","))) if len(sys.argv) == 3 else ()
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 4) or not all(0 <= n <= 1 for n in numbers):
        sys.exit(
            "usage: select_with_mavsdk.py URL x,y (a point), or URL left,top,right,bottom (a box), all from 0 to 1"
        )
    try:
        main(sys.argv[1], numbers)
    except MavsdkError as error:
        sys.exit(f"select_with_mavsdk.py: {sys.argv[1]}: {error}")
    except Empty:
        sys.exit(
            f"select_with_mavsdk.py: no camera of ours on {sys.argv[1]} within {FOUND_S:g} s: does follow run there?"
        )
