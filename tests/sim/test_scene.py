import hashlib
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from follow.geometry import Intrinsics, camera_to_ned, project
from follow.messages import Autopilot, Setpoint
from sim.scenarios import SCENARIOS, build
from sim.scene.bodies import body
from sim.scene.drawing import Drawn, View
from sim.scene.ground import block_corners
from sim.scene.optics import Lens, Optics, Sensor, streak
from sim.scene.rendering import Scene, Seen
from sim.scene.surface import SKY
from sim.scene.terrain import LEVEL, Terrain, slope
from sim.scene.world import Actor, Block, Kind, Leg, Look, Sun, Tree, World, route, wall

CAMERA = Intrinsics.from_fov(640, 360, math.radians(80.0))
BENT = replace(CAMERA, cx=320.0, cy=180.0, distortion=(-0.2, 0.03, 0.0, 0.0, 0.0))


def standing(kind: Kind = Kind.WALKER, north_m: float = 0.0, heading_rad: float = 0.0, **more) -> World:
    """A world in which someone stands still."""
    ahead = Leg(north_m + math.cos(heading_rad), math.sin(heading_rad))
    actor = Actor(kind, route(kind, (Leg(north_m, 0.0, pause_s=1e3), ahead), 1.0), Look((200, 40, 40)))
    return World((actor,), seed=5, ground_texels=1024, **more)


def view(north_m=-9.0, east_m=0.0, height_m=6.0, down_deg=30.0, roll=0.0, pitch=0.0, yaw=0.0) -> View:
    return View(CAMERA, camera_to_ned(math.radians(down_deg), roll, pitch, yaw), np.array([north_m, east_m, -height_m]))


def without(scene: Scene) -> Scene:
    """The same world with nobody there."""
    scene.world = replace(scene.world, actors=standing(north_m=500.0).actors)
    return scene


POSES = [{}, {"roll": 0.3}, {"pitch": -0.2, "yaw": 0.2}, {"east_m": 3.0, "yaw": -0.3, "height_m": 9.0}]


@pytest.mark.parametrize("pose", POSES)
def test_a_point_of_the_world_is_drawn_where_geometry_projects_it(pose):
    v = view(**pose)
    points = np.random.default_rng(0).uniform((5, -4, -3), (20, 4, 0), (50, 3))
    pixels, depth = project(CAMERA, v.rotation, v.position, points)
    mine, mine_depth = v.project(points)
    np.testing.assert_allclose(mine, pixels, atol=1e-9)
    np.testing.assert_allclose(mine_depth, depth, atol=1e-9)


UPHILL, DOWNHILL = slope(0.2, -30.0, 90.0), slope(-0.2, -30.0, 90.0, heading_rad=0.5)


@pytest.mark.parametrize("terrain", [LEVEL, UPHILL, DOWNHILL], ids=["level", "up", "down"])
@pytest.mark.parametrize("pose", POSES)
def test_the_ground_lies_where_geometry_projects_it(pose, terrain):
    """A white disc painted into the texture appears where its point of the ground is projected."""
    v = view(**pose)
    v.position[2] -= terrain.height_m(*v.position[:2])
    north, east = 3.0, 1.5
    scene = Scene(standing(terrain=terrain), CAMERA)
    ground = scene.surface.texture
    levels = tuple(np.full_like(level, 60) for level in ground.levels)
    for k, level in enumerate(levels):
        cell = 0.125 * 2**k
        before = (len(level) * cell - ground.size_m) / 2
        texel = (
            round((east - ground.east_m + before) / cell - 0.5),
            round((north - ground.north_m + before) / cell - 0.5),
        )
        cv2.circle(level, texel, max(1, round(0.5 / cell)), (255, 255, 255, 0), -1)
    scene.surface.texture = replace(ground, levels=levels, detail=np.full_like(ground.detail, 128))
    image = scene.surface.draw(v)
    rows, columns = np.nonzero(image[:, :, :3].min(axis=2) > 200)
    expected, _ = project(CAMERA, v.rotation, v.position, [(north, east, -terrain.height_m(north, east))])
    near = rows > np.median(rows) - 20  # the ground repeats, and a far copy of the disc may show
    assert (columns[near].mean() + 0.5, rows[near].mean() + 0.5) == pytest.approx(tuple(expected[0]), abs=2.5)


@pytest.mark.parametrize("terrain", [UPHILL, DOWNHILL], ids=["up", "down"])
def test_a_slope_has_no_seams_and_its_facets_are_its_height(terrain):
    """Along the heading the facets join, rise by the grade at most, and lie level beyond both ends."""
    along = np.linspace(-60.0, 90.0, 3001)
    c, s = math.cos(terrain.heading_rad), math.sin(terrain.heading_rad)
    points = np.column_stack([along * c, along * s])
    heights = terrain.heights(points)
    grade = np.diff(heights) / np.diff(along)
    assert abs(grade).max() == pytest.approx(0.2)
    assert heights[0] == 0.0
    assert abs(heights[-1]) == pytest.approx(0.2 * (90.0 - 12.0))
    for facet in terrain.facets():
        inside = (along >= facet.from_m) & (along < facet.to_m)
        plane = facet.offset_m + points[inside] @ (facet.north_grade, facet.east_grade)
        np.testing.assert_allclose(plane, heights[inside], atol=1e-9)
    assert [terrain.height_m(*p) for p in points[::300].tolist()] == pytest.approx(heights[::300].tolist())


def test_a_slope_that_is_too_short_for_its_gentle_ends_is_refused():
    with pytest.raises(ValueError, match="no room for two blends"):
        slope(0.1, 0.0, 20.0)


@pytest.mark.parametrize("terrain", [LEVEL, UPHILL, DOWNHILL], ids=["level", "up", "down"])
def test_a_shadow_falls_along_the_rays_of_the_sun_onto_the_ground(terrain):
    points = np.random.default_rng(1).uniform((-20, -20, -2), (20, 20, -1), (40, 3))
    points[:, 2] -= terrain.heights(points)
    shadow = Sun(1.0, 0.6).shadow()
    fallen = terrain.cast(points, *shadow)
    drop = fallen[:, 2] - points[:, 2]
    np.testing.assert_allclose(fallen[:, :2] - points[:, :2], drop[:, None] * shadow, atol=0.03)
    np.testing.assert_allclose(-fallen[:, 2], terrain.heights(fallen) + 0.01, atol=1e-9)


def test_a_crest_hides_what_is_behind_it_and_nothing_in_front_of_it():
    ridge = Terrain(((0.0, 0.0), (10.0, 5.0), (20.0, 0.0)))
    points = np.array([(5.0, 0.0, -2.6), (25.0, 0.0, 0.0), (25.0, 0.0, -9.1), (-5.0, 0.0, 0.0)])
    assert ridge.hides(np.array([-10.0, 0.0, -2.0]), points).tolist() == [False, True, False, False]
    assert ridge.hides(np.array([-10.0, 0.0, -30.0]), points).tolist() == [False] * 4
    scene = Scene(standing(north_m=25.0, terrain=ridge), CAMERA)
    low, high = view(-10.0, height_m=2.0, down_deg=0.0), view(-10.0, height_m=30.0, down_deg=40.0)
    assert scene.draw(low, 0.0)[1][0].visible == 0.0
    assert scene.draw(high, 0.0)[1][0].visible == 1.0


@pytest.mark.parametrize("grade", [0.2, -0.2])
def test_a_walker_on_a_slope_looks_the_same_from_the_same_side(grade):
    """The camera goes up with the actor: the box is the one on level ground, and the body stands on the slope."""
    terrain = slope(grade, -30.0, 90.0)
    level, hill = Scene(standing(), CAMERA), Scene(standing(terrain=terrain), CAMERA)
    v = view()
    raised = replace(v, position=v.position - (0.0, 0.0, terrain.height_m(0.0, 0.0)))
    assert hill.world.target(0.0).down_m == -terrain.height_m(0.0, 0.0) != 0.0
    (flat,), (tilted,) = level.draw(v, 0.0)[1], hill.draw(raised, 0.0)[1]
    assert (tilted.box.x, tilted.box.y, tilted.box.w, tilted.box.h) == pytest.approx(
        (flat.box.x, flat.box.y, flat.box.w, flat.box.h), abs=0.1
    )


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("heading", [0.0, 1.2, 3.0])
def test_the_true_box_holds_the_body_and_nothing_more(kind, heading):
    world = standing(kind, heading_rad=heading)
    v = view(-20.0, height_m=9.0, down_deg=22.0)
    scene = Scene(world, CAMERA)
    image, (seen,) = scene.draw(v, 0.0)
    points = body(world.actors[0], world.target(0.0), world.sun).points
    pixels, _ = project(CAMERA, v.rotation, v.position, points)
    box = seen.box
    assert seen.visible == 1.0
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    slack = 0.2 * CAMERA.fx / 20  # limbs are up to 0.2 m thick
    assert low[0] - slack - 1 <= box.x <= low[0] + 1
    assert low[1] - slack - 1 <= box.y <= low[1] + 1
    assert high[0] - 1 <= box.x + box.w <= high[0] + slack + 1
    empty = without(scene).draw(v, 0.0)[0]
    changed = np.abs(image.astype(int) - empty)[:, :, :3].sum(axis=2) > 60
    inside = changed[int(box.y) : int(box.y + box.h) + 1, int(box.x) : int(box.x + box.w) + 1]
    assert inside.mean() > 0.25


def test_a_target_twice_as_far_looks_half_as_large():
    scene = Scene(standing(), CAMERA)
    near = scene.draw(view(-15.0, height_m=0.9, down_deg=0.0), 0.0)[1][0].box
    far = scene.draw(view(-30.0, height_m=0.9, down_deg=0.0), 0.0)[1][0].box
    assert far.h == pytest.approx(near.h / 2, rel=0.05)


def test_a_wall_between_hides_and_a_wall_behind_does_not():
    behind = standing(blocks=wall(2.0, -4.0, 8.0, math.pi / 2, 3.0))
    between = standing(blocks=wall(-1.0, -4.0, 8.0, math.pi / 2, 3.5))
    assert Scene(behind, CAMERA).draw(view(), 0.0)[1][0].visible == 1.0
    assert Scene(between, CAMERA).draw(view(), 0.0)[1][0].visible == 0.0


def test_a_wall_hides_as_much_as_its_height_says():
    """A camera at the height of a walker's hip sees what rises over a low wall half way, by similar triangles."""
    scene = Scene(standing(blocks=wall(-5.0, -4.0, 8.0, math.pi / 2, 0.9)), CAMERA)
    seen = scene.draw(view(-10.0, height_m=0.9, down_deg=0.0), 0.0)[1][0]
    assert 0.35 < seen.visible < 0.75  # all above 0.9 m of 1.7 m, where shoulders are wider than legs


@pytest.mark.parametrize("yaw", [-0.6, 0.0, 0.4])
def test_a_wall_that_begins_behind_the_camera_hides_a_person_behind_it(yaw):
    """Its rays decide: what meets the wall's near face ahead of the camera has the wall's colour."""
    long = wall(-10.3, -1.0, 40.0, 0.0, 5.0, (0, 0, 250))
    v = view(0.0, -1.6, height_m=1.0, down_deg=0.0, yaw=yaw)
    image, (seen,) = Scene(standing(north_m=4.0, blocks=long), CAMERA).draw(v, 0.0)
    assert seen.visible == 0.0
    beside = min(long, key=lambda block: abs(block.north_m))
    west = -1.0 - beside.width_m / 2
    face = np.random.default_rng(1).uniform((0.4, west, -4.8), (12.0, west, -0.2), (400, 3))
    pixels, depth = project(CAMERA, v.rotation, v.position, face)
    inside = (depth > 0.5) & (pixels > 2).all(axis=1) & (pixels < (638, 358)).all(axis=1)
    x, y = pixels[inside].astype(int).T
    red = (image[y, x, 2] > 60) & (image[y, x, 1] < 20) & (image[y, x, 0] < 20)
    assert inside.sum() > 50
    assert red.mean() > 0.98


@pytest.mark.parametrize("windows", [False, True])
@pytest.mark.parametrize("heading", [0.0, 1.0, 2.5, 4.0])
def test_a_house_shows_its_near_sides_and_hides_a_person_inside(heading, windows):
    """Its lowest pixel lies where the nearest corner of its base is projected: the far sides are not drawn."""
    house = Block(6.0, 0.0, 12.0, 8.0, 5.0, heading, (0, 0, 250), (0, 250, 0), windows=windows)
    scene = Scene(standing(north_m=7.0, blocks=(house,)), CAMERA)
    v = view(-20.0, height_m=7.0, down_deg=20.0)
    image, (seen,) = scene.draw(v, 0.0)
    empty = Scene(standing(north_m=7.0), CAMERA).draw(v, 0.0)[0]
    base, _ = v.project(np.column_stack([block_corners(house), np.zeros(4)]))
    reds = (image[:, :, 2] > 100) & (image[:, :, 1] < 20) & (image[:, :, 0] < 20) & (empty[:, :, 1] > 20)
    assert np.flatnonzero(reds.any(axis=1)).max() == pytest.approx(base[:, 1].max(), abs=3.0)
    assert seen.visible == 0.0


def test_a_tree_between_hides():
    trees = tuple(Tree(-2.0, east, 4.0, 1.9, 0) for east in (-0.6, 0.6))
    assert Scene(standing(trees=trees), CAMERA).draw(view(), 0.0)[1][0].visible < 0.3


def test_an_actor_that_leaves_the_image_is_not_visible():
    turned = Scene(standing(), CAMERA).draw(view(yaw=1.2), 0.0)[1][0]
    assert turned.visible == 0.0
    assert turned.box is None or turned.box.x + turned.box.w < 0 or turned.box.x > CAMERA.width
    behind = Scene(standing(), CAMERA).draw(view(north_m=9.0), 0.0)[1][0]
    assert behind == Seen(None, 0.0)


def test_a_car_cut_to_a_line_by_the_near_plane_is_not_visible(monkeypatch):
    line = Drawn(1.0, [], (300.0, 100.0), (300.0, 250.0))
    monkeypatch.setattr("sim.scene.rendering.drawn_body", lambda *_: line)
    assert Scene(standing(Kind.CAR), CAMERA).draw(view(), 0.0)[1] == (Seen(None, 0.0),)


def test_the_sky_is_above_the_horizon():
    image = Scene(standing(), CAMERA).draw(view(down_deg=0.0), 0.0)[0]
    blue = image[:, :, 0]
    assert blue[:150].mean() > 200
    assert blue[210:].mean() < 150


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_camera_that_looks_up_sees_nothing_but_sky(yaw):
    image = Scene(standing(), CAMERA).draw(view(down_deg=-60.0, yaw=yaw), 0.0)[0]
    assert np.all(image[:, :, :3] == SKY)


def test_a_shadow_lies_on_the_side_away_from_the_sun():
    def darker(azimuth: float) -> tuple[float, float]:
        sun = Sun(azimuth, 0.6)
        v = view(-12.0, height_m=8.0, down_deg=33.0)
        scene = Scene(standing(sun=sun), CAMERA)
        shown = scene.draw(v, 0.0)[0][:, :, :3].astype(float).sum(axis=2)
        empty = without(scene).draw(v, 0.0)[0][:, :, :3].astype(float).sum(axis=2)
        dark = shown < 0.75 * empty
        return dark[:, :300].sum(), dark[:, 340:].sum()

    left, right = darker(math.pi / 2)  # sun in the east, the right of a camera that looks north
    assert left > 50 > right
    left, right = darker(-math.pi / 2)
    assert right > 50 > left


def digest(name: str, seed: int, rounds: int = 5) -> str:
    camera, link, _ = build(SCENARIOS[name], seed, Autopilot.PX4)
    total = hashlib.sha256()
    for k, frame in enumerate(camera.frames()):
        link.send(Setpoint(1.0, 0.0, 0.0, 0.2))
        if frame is not None:
            total.update(frame.image.tobytes())
        total.update(repr(link.state()).encode())
        if k == rounds:
            break
    return total.hexdigest()


@pytest.mark.parametrize("name", ["walker", "wind", "dusk"])
def test_the_same_seed_gives_the_same_bytes(name):
    assert digest(name, 3) == digest(name, 3)


def test_another_seed_gives_another_flight():
    assert digest("walker", 3) != digest("walker", 4)


def test_the_first_frame_can_be_had_before_the_flight():
    camera, _, _ = build(SCENARIOS["dusk"], 1, Autopilot.ARDUPILOT)
    first, box = camera.first()
    frame = next(f for f in camera.frames() if f is not None)
    assert np.array_equal(first.image, frame.image)
    assert camera.truth(0).box == box


def test_a_straight_lens_changes_nothing_and_a_bent_one_moves_boxes_with_the_image():
    image = np.random.default_rng(0).integers(0, 256, (360, 640, 4), np.uint8)
    assert np.array_equal(Lens(CAMERA).bend(image), image[:, :, :3])
    bent = Lens(BENT)
    scene = Scene(standing(), bent.ideal)
    v = View(bent.ideal, camera_to_ned(0.3, 0.0, 0.0, 0.45), np.array([-9.0, 0.0, -6.0]))
    drawn, (seen,) = scene.draw(v, 0.0)
    marked = np.zeros_like(drawn)
    b = seen.box
    marked[round(b.y) : round(b.y + b.h), round(b.x) : round(b.x + b.w)] = 255
    rows, columns = np.nonzero(bent.bend(marked)[:, :, 0] > 127)
    box = bent.bend_box(seen).box
    assert (columns.min(), rows.min()) == pytest.approx((box.x, box.y), abs=1.5)
    assert (columns.max() + 1, rows.max() + 1) == pytest.approx((box.x + box.w, box.y + box.h), abs=1.5)


@pytest.mark.parametrize("distortion", [(-0.2, 0.03, 0, 0, 0), (0.1, 0, 0, 0, 0), (-0.1, 0, 0.01, -0.01, 0)])
def test_a_bent_image_has_no_black_corners(distortion):
    lens = Lens(replace(BENT, distortion=distortion))
    full = np.full((lens.ideal.height, lens.ideal.width, 4), 200, np.uint8)
    assert lens.bend(full).min() == 200


@pytest.mark.parametrize("smear", [(6.0, 0.0), (0.0, -4.0), (3.0, 5.0)])
def test_a_streak_keeps_brightness_and_is_as_long_as_the_motion(smear):
    kernel = streak(smear)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    rows, columns = np.nonzero(kernel)
    assert np.ptp(columns) == pytest.approx(abs(smear[0]), abs=1)
    assert np.ptp(rows) == pytest.approx(abs(smear[1]), abs=1)


def test_noise_has_the_standard_deviation_it_is_given():
    quiet, loud = (Optics(noise=n, shutter_s=1e-6) for n in (0.0, 6.0))
    image = np.full((360, 640, 3), 120, np.uint8)
    clean, noisy = (Sensor(o, 1.0, 1).expose(image, (0.0, 0.0), 0.0, 0) for o in (quiet, loud))
    assert np.array_equal(clean, image)
    assert (noisy.astype(float) - image).std() == pytest.approx(6.0, rel=0.05)
