"""What a camera sees of textured flat ground: cheap images in which corners move as the vehicle does.

The ground is one homography away from the image, so a whole flight of images takes seconds.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Intrinsics, camera_to_ned
from sim.dynamics import VehicleTruth

METRES_PER_TEXEL = 0.08
TEXELS = 1024
HORIZON_SINE = 0.05  # rays that fall less than this show sky: the texture there would be finer than a pixel
SKY = 200


def texture() -> NDArray[np.uint8]:
    """Grass and gravel: noise of four sizes."""
    random = np.random.default_rng(7)
    total = np.zeros((TEXELS, TEXELS), np.float32)
    for sigma in (1.0, 3.0, 9.0, 27.0):
        noise = random.standard_normal((TEXELS, TEXELS)).astype(np.float32)
        soft = cv2.GaussianBlur(noise, (0, 0), sigma)
        total += soft / soft.std()
    return np.clip(110 + 25 * total, 0, 255).astype(np.uint8)


GROUND = texture()


def look(lens: Intrinsics, down_rad: float, m: VehicleTruth) -> NDArray[np.uint8]:
    """The image at a true pose, (rows, columns) in grey; the ground lies at down = 0."""
    axes = camera_to_ned(down_rad, m.roll_rad, m.pitch_rad, m.yaw_rad).T  # NED to camera
    # A ground point (n, e, 0) has the pixel K axes ((n, e, 0) - position): a homography of (n, e, 1).
    columns = np.column_stack([axes[:, 0], axes[:, 1], -axes @ (m.north_m, m.east_m, m.down_m)])
    k = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    texel = np.diag([METRES_PER_TEXEL, METRES_PER_TEXEL, 1.0])
    to_pixel = k @ columns @ texel
    size = lens.width, lens.height
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(GROUND, np.linalg.inv(to_pixel), size, flags=flags, borderMode=cv2.BORDER_WRAP)
    rows, columns_px = np.mgrid[0 : lens.height, 0 : lens.width]
    fall = axes[0, 2] * (columns_px - lens.cx) / lens.fx + axes[1, 2] * (rows - lens.cy) / lens.fy + axes[2, 2]
    image[fall < HORIZON_SINE * math.sqrt(2.0)] = SKY
    return image
