"""Which pixels show the wire, which were seen past it, and which say nothing."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_needle import ARC, FLOOR_RGB, LENS, STEEL_RGB, T_CAMERA_FLOOR, over_floor, picture
from trocar.geometry import SE3, SO3
from trocar.perception.depth import Patch, pixel_rays
from trocar.tasks.suture.perception import APART_M, CLOSE_M, along_rays, clearance_m, colors, gather_evidence

NEAR_M = 1.3e-3
TRUE = over_floor(np.random.default_rng(0))
IMAGE = picture(TRUE, np.random.default_rng(0), 0.0)


def seen(images=(IMAGE,), at=TRUE, near_m=NEAR_M, occluders=None, every=1):
    return gather_evidence(images, at, ARC, near_m, T_CAMERA_FLOOR, occluders, every)


def passing(rays, T_camera_needle=TRUE):
    """Return how deep (n,) rays are nearest to the wire's surface, and how far (n,) from it, by many places on each."""
    z = T_camera_needle.translation_m[2] + np.arange(-10e-3, 10e-3, 0.1e-3)
    places = T_camera_needle.inverse().apply((rays[:, None] * z[:, None]).reshape(-1, 3))
    distance = ARC.distance_m(places).reshape(len(rays), -1)
    return z[distance.argmin(axis=1)], distance.min(axis=1)


def rays_of(*pixels):
    return np.array([pixel_rays(LENS)[v, u] for u, v in pixels])


SOME = pixel_rays(LENS)[::5, ::5].reshape(-1, 3)


def floor_depth(rays):
    T_floor = T_CAMERA_FLOOR.inverse()
    return -T_floor.translation_m[2] / (rays @ T_floor.rotation.matrix[2])


# Where rays pass the wire.


def test_rays_pass_the_wire_where_and_as_far_away_as_they_do():
    depth, apart = along_rays(SOME, TRUE, ARC, NEAR_M)
    where, least = passing(SOME)
    near = least < NEAR_M
    assert near.sum() > 30 and np.isfinite(apart[near]).all()
    outside = near & (least > 0.2e-3)  # within the wire, all places are as good
    np.testing.assert_allclose(apart[outside], least[outside], atol=0.05e-3)
    wide = np.linalg.norm(rays_of((69, 69))[0]) * np.abs(depth - where)
    assert np.median(wide[outside]) < 0.3e-3
    through = least < -0.3e-3
    assert through.sum() >= 4 and (apart[through] < -0.2e-3).all()
    assert np.isinf(apart[least > 2.0 * NEAR_M + ARC.wire_m]).all()


def test_a_needle_of_which_all_is_told_gives_points_on_it_and_rays_through_it():
    found = seen()
    assert found is not None
    rays = IMAGE.depth_m.ravel()[:, None] * pixel_rays(LENS).reshape(-1, 3)
    on = np.abs(ARC.distance_m(TRUE.inverse().apply(rays))) < 0.02e-3
    steel = (IMAGE.color.reshape(-1, 3) == STEEL_RGB).all(axis=1)
    assert len(found.points) == len(found.through) == steel.sum() == on.sum()
    assert np.abs(ARC.distance_m(TRUE.inverse().apply(found.points))).max() < 0.02e-3
    assert found.pixel_m == pytest.approx(TRUE.translation_m[2] / LENS.fx)


@pytest.mark.parametrize("near_m", [NEAR_M, 5e-3])
@pytest.mark.parametrize("facing", [False, True])
def test_all_rays_near_the_wire_are_read(near_m, facing):
    """Of a needle high over the floor, upright or facing the camera."""
    at = T_CAMERA_FLOOR @ SE3.from_parts(translation_m=[0.0, 0.0, 6e-3]) @ T_CAMERA_FLOOR.inverse() @ TRUE
    at = SE3.from_parts(translation_m=[0.0, 0.0, 0.33]) if facing else at
    image = picture(at, np.random.default_rng(0), 0.0)
    found = seen([image], at, near_m)
    assert found is not None
    _, apart = along_rays(pixel_rays(LENS).reshape(-1, 3), at, ARC, near_m)
    steel = (image.color.reshape(-1, 3) == STEEL_RGB).all(axis=1)
    assert len(found.past) == ((apart < near_m) & ~steel).sum()


def test_places_along_rays_lie_close_enough_to_tell_where_the_wire_is_nearest():
    """Also if the needle is a millimetre deeper or nearer than it was expected."""
    found = seen()
    assert found is not None
    for deeper_m in (-1e-3, 0.0, 1.2e-3):
        at = TRUE @ SE3.from_parts(translation_m=TRUE.rotation.inverse().apply([0.0, 0.0, deeper_m]))
        for places in (found.through, found.past):
            rays = places[:, 0] / places[:, :1, 2]
            _, least = passing(rays, at)
            sampled = ARC.distance_m(at.inverse().apply(places.reshape(-1, 3))).reshape(places.shape[:2]).min(axis=1)
            outside = least > 0.0
            assert (sampled - least)[outside].max(initial=0.0) < 0.07e-3
            np.testing.assert_allclose(places / places[..., 2:], np.repeat(rays[:, None], places.shape[1], 1))


def test_one_of_so_many_rows_and_columns_is_read():
    every, third = seen(), seen(every=3)
    assert every is not None and third is not None
    assert len(third.through) == pytest.approx(len(every.through) / 9, rel=0.2)
    assert third.pixel_m == pytest.approx(3 * every.pixel_m)


def test_every_image_gives_points_and_the_first_one_the_colours():
    once, twice = seen(), seen([IMAGE, IMAGE])
    assert once is not None and twice is not None
    assert len(twice.points) == 2 * len(once.points) and len(twice.through) == len(once.through)
    plain = replace(IMAGE, color=np.full_like(IMAGE.color, 200))
    again = seen([IMAGE, plain])
    assert again is not None and len(again.through) == len(once.through)
    assert seen([plain, IMAGE]) is None


# Too little.


def with_pixels(count, with_depth, images=1):
    """Return images in which so many pixels are of steel, and so many of those have depth."""
    steel = np.argwhere((IMAGE.color == STEEL_RGB).all(axis=2))[::9]
    color, depth = np.full_like(IMAGE.color, FLOOR_RGB), floor_depth(pixel_rays(LENS)).astype(np.float32)
    for number, (v, u) in enumerate(steel[:count]):
        color[v, u] = STEEL_RGB
        depth[v, u] = IMAGE.depth_m[v, u] if number < with_depth else np.nan
    return [replace(IMAGE, color=color, depth_m=depth)] * images


@pytest.mark.parametrize(
    ("count", "with_depth", "enough"), [(12, 12, True), (11, 11, False), (12, 5, True), (12, 4, False), (20, 5, True)]
)
def test_a_dozen_pixels_two_fifths_of_them_with_depth_are_enough(count, with_depth, enough):
    found = seen(with_pixels(count, with_depth))
    assert (found is not None) == enough
    if found is not None:
        assert len(found.through) == count and len(found.points) == with_depth


@pytest.mark.parametrize(("height_m", "is_seen"), [(1.2e-3, True), (0.2e-3, False)])
def test_what_is_as_low_as_the_floor_is_no_needle(height_m, is_seen):
    lying = T_CAMERA_FLOOR @ SE3.from_parts(translation_m=[0.0, 0.0, height_m])
    assert (seen([picture(lying, np.random.default_rng(0), 0.0)], lying) is not None) == is_seen


# What hides it, and what is behind it.


@pytest.mark.parametrize(("nearer_m", "hidden"), [(2.2e-3, False), (3.6e-3, True)])
def test_what_is_seen_much_nearer_hides_the_wire(nearer_m, hidden):
    """By more than the wire may be off (1.3 mm) and a bit; in any of the images."""
    depth = np.where((IMAGE.color == STEEL_RGB).all(axis=2), IMAGE.depth_m - nearer_m, IMAGE.depth_m)
    found = seen([IMAGE, replace(IMAGE, depth_m=depth.astype(np.float32))])
    assert (found is None) == hidden


@pytest.mark.parametrize(("behind_m", "is_past"), [(1.0e-3, False), (2.2e-3, True)])
def test_what_lies_far_enough_behind_the_wire_was_seen_past_it_whatever_its_colour(behind_m, is_past):
    """A blue cloth so far behind; the floor shows by its colour even where it has no depth."""
    steel = (IMAGE.color == STEEL_RGB).all(axis=2)
    rays = pixel_rays(LENS)
    wire_depth, apart = along_rays(rays.reshape(-1, 3), TRUE, ARC, NEAR_M)
    cloth = ~steel & (apart < NEAR_M).reshape(steel.shape)
    depth = np.where(cloth, wire_depth.reshape(steel.shape) + behind_m, IMAGE.depth_m).astype(np.float32)
    color = np.where(cloth[..., None], (60, 80, 220), IMAGE.color).astype(np.uint8)
    found = seen([replace(IMAGE, color=color, depth_m=depth)])
    assert found is not None
    assert (len(found.past) > 0.9 * cloth.sum()) if is_past else len(found.past) == 0
    bare = seen([replace(IMAGE, depth_m=np.where(cloth, np.nan, IMAGE.depth_m).astype(np.float32))])
    assert bare is not None and len(bare.past) > 0.9 * cloth.sum()


@pytest.mark.parametrize(
    ("near_m", "behind_m", "is_taken"),
    [(NEAR_M, 1.7e-3, True), (NEAR_M, 2.5e-3, False), (5e-3, 3.0e-3, True), (5e-3, 5.5e-3, False)],
)
def test_steel_far_behind_the_wire_is_an_instrument_and_no_part_of_the_wire(near_m, behind_m, is_taken):
    """All that surrounds the wire is of steel; it is not seen past the wire either, for steel has no floor's colour.

    The jaws' far finger is 3 mm behind a wire that is known to a millimetre.
    """
    steel = (IMAGE.color == STEEL_RGB).all(axis=2)
    wire_depth, apart = along_rays(pixel_rays(LENS).reshape(-1, 3), TRUE, ARC, near_m)
    plate = ~steel & (apart < near_m).reshape(steel.shape)
    depth = np.where(plate, wire_depth.reshape(steel.shape) + behind_m, IMAGE.depth_m).astype(np.float32)
    image = replace(IMAGE, color=np.where(plate[..., None], STEEL_RGB, IMAGE.color).astype(np.uint8), depth_m=depth)
    found = seen([image], near_m=near_m)
    plain = seen()
    assert found is not None and plain is not None and len(found.past) == 0
    assert len(found.through) == len(plain.through) + (plate.sum() if is_taken else 0)


def test_points_on_something_else_say_nothing():
    found = seen(occluders=lambda points: np.linalg.norm(points - TRUE.apply(ARC.point_m(np.ones(1))), axis=1) - 2e-3)
    everything = seen()
    assert found is not None and everything is not None
    for some, all_ in ((found.through, everything.through), (found.past, everything.past)):
        away = np.linalg.norm(all_[:, 4] - TRUE.apply(ARC.point_m(np.ones(1))), axis=1)
        assert (away > 5e-3).sum() <= len(some) <= (away > 2e-3).sum() < len(all_)


# Rays that something else hides.


RAY = np.array([[0.1, -0.05, 1.0]])


def apart_m(along_m, beside_m=0.0):
    """Return the clearance of a ray that meets the wire .3 m deep from a point so far along it, and beside it."""
    place = RAY[0] * (0.3 + along_m) + [beside_m, 0.0, 0.0]
    return clearance_m(lambda p: np.linalg.norm(p - place, axis=1), RAY, np.array([0.3]))[0]


def test_nothing_on_a_ray_goes_unnoticed_from_eight_centimetres_before_the_wire_to_just_behind_it():
    assert all(apart_m(along) <= CLOSE_M for along in np.arange(-0.080, 0.0028, 0.25e-3))
    assert not any(apart_m(along) <= APART_M for along in (-0.0812, -0.1, 0.0042, 0.01))
    assert all(apart_m(along, 0.8e-3) == pytest.approx(0.8e-3, abs=0.1e-3) for along in (-0.05, -0.01, 0.0))


def test_rays_are_judged_one_by_one():
    """As if every place along every ray had been asked for."""
    rng = np.random.default_rng(0)
    rays = np.column_stack([rng.uniform(-0.1, 0.1, (60, 2)), np.ones(60)])
    depth = rng.uniform(0.25, 0.35, 60)
    balls = rays[::2] * (depth[::2] + rng.uniform(-0.1, 0.02, 30))[:, None] + rng.uniform(-6e-3, 6e-3, (30, 3))

    def elsewhere(points):
        return np.linalg.norm(points[:, None] - balls, axis=2).min(axis=1) - 3e-3

    places = rays[:, None] * (depth[:, None] + np.arange(-0.08, 0.0026, 0.25e-3))[..., None]
    expected = elsewhere(places.reshape(-1, 3)).reshape(60, -1).min(axis=1)
    assert 10 < (expected > APART_M).sum() < 50
    found = clearance_m(elsewhere, rays, depth)
    near = expected < APART_M
    assert (found[expected < 0.0] <= CLOSE_M).all() and (found[~near] > APART_M).all()
    outside = near & (expected > CLOSE_M)
    np.testing.assert_allclose(found[outside], expected[outside], atol=0.15e-3)
    assert clearance_m(elsewhere, np.zeros((0, 3)), np.zeros(0)).shape == (0,)


def test_steel_beside_the_jaws_is_of_the_wire_if_the_wire_is_nearer():
    """The picture of a wire that is a millimetre thicker all round; on its right, it touches a finger's side."""
    rays = pixel_rays(LENS).reshape(-1, 3)
    wire_z, beside = along_rays(rays, TRUE, ARC, NEAR_M)
    thick = np.where((beside < 1e-3)[:, None], STEEL_RGB, IMAGE.color.reshape(-1, 3)).astype(np.uint8)
    depth = np.where(beside < 1e-3, wire_z, IMAGE.depth_m.ravel()).astype(np.float32)
    image = replace(IMAGE, color=thick.reshape(IMAGE.color.shape), depth_m=depth.reshape(IMAGE.depth_m.shape))
    side = rays[beside < 0.0, 0].max() + 0.8e-3 / TRUE.translation_m[2]
    normal = np.array([-1.0, 0.0, side]) / np.hypot(1.0, side)

    def finger(points):
        return points @ normal

    apart = np.full(len(rays), np.inf)
    near = beside < NEAR_M
    apart[near] = clearance_m(finger, rays[near], wire_z[near])
    close = beside[(beside < 1e-3) & (apart > CLOSE_M) & (apart < APART_M)]
    found, wider = seen([image], occluders=finger), seen([image])
    assert found is not None and wider is not None and (close < 0.0).sum() > 10 and (close > 0.3e-3).sum() > 10
    lost = len(wider.through) - len(found.through)
    assert lost == pytest.approx((close > 0.2e-3).sum() + ((beside < 1e-3) & (apart <= CLOSE_M)).sum(), rel=0.1)


def test_close_to_the_floor_steel_is_of_the_wire_and_the_floor_says_nothing():
    """Of a needle in the tissue, as if it were deeper: what shows steel is out of the tissue all the same."""
    lower = T_CAMERA_FLOOR @ SE3.from_parts(translation_m=[0.0, 0.0, -8e-3]) @ T_CAMERA_FLOOR.inverse()
    sunk = lower @ TRUE
    whole, ground = picture(sunk, np.random.default_rng(0), 0.0), floor_depth(pixel_rays(LENS))
    under = whole.depth_m > ground - 1e-6
    color = np.where(under[..., None], FLOOR_RGB, whole.color).astype(np.uint8)
    image = replace(whole, color=color, depth_m=np.minimum(whole.depth_m, ground).astype(np.float32))
    up = T_CAMERA_FLOOR.rotation.matrix[:, 2]
    deep = SE3.from_parts(translation_m=-0.3e-3 * up) @ sunk
    there, deeper = seen([image], at=sunk), seen([image], at=deep)
    assert there is not None and deeper is not None
    steel = (color == STEEL_RGB).all(axis=2)
    assert len(there.through) == steel.sum() and len(deeper.through) > 0.98 * steel.sum()
    assert T_CAMERA_FLOOR.inverse().apply(there.past[:, 4])[:, 2].min() == pytest.approx(0.7e-3, abs=0.1e-3)


# Colours.


def told(*pixels):
    """Return (floor, steel) for each pixel (colour, height over the floor or NaN), among many of the floor."""
    color, height = zip(*[(FLOOR_RGB, 0.0)] * 9, *pixels, strict=True)
    T_floor = SE3.from_parts(SO3.axis("x", np.pi), [0.0, 0.0, 0.4])
    rays = np.tile([0.0, 0.0, 1.0], (1, len(color), 1))
    patch = Patch(rays, 0.4 - np.array([height]), np.array([color], dtype=np.uint8))
    floor, steel = colors(patch, T_floor.inverse())
    assert floor[:9].all() and not steel[:9].any()
    return list(zip(floor[9:].tolist(), steel[9:].tolist(), strict=True))


FLOOR, STEEL, NEITHER = (True, False), (False, True), (False, False)


def test_colours_tell_floor_and_steel_at_any_height():
    shade = tuple(value // 3 for value in FLOOR_RGB)
    said = told((FLOOR_RGB, np.nan), (STEEL_RGB, np.nan), (shade, 0.01), ((60, 61, 64), 0.01), ((60, 80, 220), 0.0))
    assert said == [FLOOR, STEEL, FLOOR, STEEL, NEITHER]


@pytest.mark.parametrize(
    ("colours", "height_m", "expected"),
    [
        # an eighth of the floor's light, 523 of three channels, is just enough
        (((22, 22, 22), (20, 20, 20), (28, 21, 18), (24, 18, 15)), 0.01, [STEEL, NEITHER, FLOOR, NEITHER]),
        (((0, 0, 0),), 0.01, [NEITHER]),
        # the floor's shares are .421 .312 .268; up to a twentieth of the light is alike
        (((93, 57, 50), (97, 54, 49), (75, 72, 53), (72, 75, 53)), 0.0, [FLOOR, NEITHER, FLOOR, NEITHER]),
        # steel is grey up to a quarter
        (((151, 200, 200), (149, 200, 200), (110, 200, 200)), 0.01, [STEEL, NEITHER, NEITHER]),
    ],
)
def test_shadows_the_floors_colour_and_grey_have_bounds(colours, height_m, expected):
    assert told(*((colour, height_m) for colour in colours)) == expected


@pytest.mark.parametrize(("height_m", "counts"), [(0.8e-3, True), (1.3e-3, False)])
def test_the_floors_colour_is_that_of_what_lies_on_it(height_m, counts):
    """A green cloth of such a thickness that covers more than the floor does."""
    green = (40, 160, 60)
    for sign in (1.0, -1.0):
        T_floor = SE3.from_parts(translation_m=[0.0, 0.0, 0.4])
        rays = np.tile([0.0, 0.0, 1.0], (1, 30, 1))
        depth = np.where(np.arange(30) < 20, 0.4 + sign * height_m, 0.4)[None]
        color = np.where(np.arange(30)[None, :, None] < 20, green, FLOOR_RGB).astype(np.uint8)
        floor, _ = colors(Patch(rays, depth, color), T_floor.inverse())
        assert floor[:20].all() == counts and floor[20:].all() != counts


def test_without_a_floor_no_colour_is_told():
    patch = Patch(np.tile([0.0, 0.0, 1.0], (1, 5, 1)), np.full((1, 5), 0.3), np.full((1, 5, 3), 200, np.uint8))
    floor, steel = colors(patch, SE3.from_parts(translation_m=[0.0, 0.0, 0.4]).inverse())
    assert floor.tolist() == steel.tolist() == [False] * 5


def test_glare_on_the_floor_does_not_change_its_light():
    assert told(*[((255, 255, 255), 0.0)] * 4, ((22, 22, 22), 0.01))[-1] == STEEL
