"""MAVSDK's own Camera client: an implementation of the camera protocol that is not ours, on either side of it."""

import json

from mavsdk import Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.camera.camera import Camera
from mavsdk.plugins.mavlink_direct import MavlinkDirect

from tests.support.real_flight import until

SYSTEM, COMPONENT = 245, 190  # a ground station's
FOUND_S = 20.0


class CameraClient:
    """Connected to `url` as a ground station; `cameras` are those that it knows, `statuses` what it was told.

    Every call that is refused or not answered raises MAVSDK's CameraError.
    """

    def __init__(self, url):
        log_subscribe(lambda *_log: True)
        self.cameras, self.statuses, self.texts = [], [], []
        self._mavsdk = Mavsdk(Configuration.create_manual(SYSTEM, COMPONENT, True))
        self._mavsdk.add_any_connection(url)

    def __enter__(self):
        try:
            until("heard by MAVSDK", lambda: self._mavsdk.system_count() > 0, FOUND_S)
            (system,) = self._mavsdk.get_systems()
            self.camera, self.direct = Camera(system), MavlinkDirect(system)
            self._handles = [
                self.direct.subscribe_message("CAMERA_TRACKING_IMAGE_STATUS", self._status),
                self.direct.subscribe_message("STATUSTEXT", self._text),
            ]
            self._listing = self.camera.subscribe_camera_list(self._list)
            until("listed by MAVSDK", lambda: bool(self.cameras), FOUND_S)
        except BaseException:
            self._mavsdk.destroy()
            raise
        return self

    def __exit__(self, *_error):
        self.camera.unsubscribe_camera_list(self._listing)
        for handle in self._handles:
            self.direct.unsubscribe_message(handle)
        self._mavsdk.destroy()

    def _list(self, found, _user):
        self.cameras = list(found.cameras)

    def _status(self, message, _user):
        self.statuses.append(json.loads(message.fields_json))

    def _text(self, message, _user):
        self.texts.append(json.loads(message.fields_json)["text"])

    @property
    def component(self):
        """The id of the first camera."""
        return self.cameras[0].component_id

    def track(self, left, top, right, bottom):
        self.camera.track_rectangle(self.component, left, top, right, bottom)

    def track_point(self, x, y, radius):
        self.camera.track_point(self.component, x, y, radius)

    def stop(self):
        self.camera.track_stop(self.component)
