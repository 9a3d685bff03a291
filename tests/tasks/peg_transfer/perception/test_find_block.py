import mujoco
import numpy as np
import pytest
from random_cells import overhead, random_scene, world_of

from simulated import scene_of, standing
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.perception.blocks import find_block, find_held_block
from trocar.tasks.peg_transfer.perception.board import find_board


@pytest.fixture(scope="module", params=range(3))
def view(request):
    rng = np.random.default_rng(1000 + request.param)
    scene, pegs = random_scene(rng)
    model, data = world_of(scene)
    camera = overhead(model)
    return scene, pegs, camera, camera.render(data, rng)


def test_finds_every_block_and_no_other(view):
    scene, pegs, camera, image = view
    T_camera_board = camera.T_world_camera.inverse() @ scene.T_world_board
    fits = [find_block(image, T_camera_board, scene.board, scene.block, peg) for peg in range(12)]
    assert [peg for peg, fit in enumerate(fits) if not isinstance(fit, str)] == sorted(pegs)
    for true, peg in zip(scene.T_world_blocks.matrix, pegs, strict=True):
        error = SE3(true).inverse() @ (scene.T_world_board @ fits[peg])
        assert np.linalg.norm(error.translation_m) < 0.35e-3
        yaw = np.degrees(np.arctan2(error.matrix[1, 0], error.matrix[0, 0]))
        assert abs((yaw + 60) % 120 - 60) < 2.5
        assert error.matrix[2, 2] > np.cos(np.radians(3)), "z must point into the block"


def test_an_empty_peg_says_why(view):
    scene, pegs, camera, image = view
    empty = next(peg for peg in range(12) if peg not in pegs)
    fit = find_block(image, camera.T_world_camera.inverse() @ scene.T_world_board, scene.board, scene.block, empty)
    assert isinstance(fit, str) and "pixels" in fit


@pytest.mark.parametrize("sign", [-1, 1])
def test_finds_the_board_from_a_poor_guess(view, sign):
    scene, _, camera, image = view
    guess = scene.T_world_board @ SE3.exp(sign * np.array([5e-3, -4e-3, 2e-3, 0.02, -0.02, 0.05]))
    T_world_board = find_board(image, camera.T_world_camera, scene.board, guess)
    assert isinstance(T_world_board, SE3)
    error = (scene.T_world_board.inverse() @ T_world_board).log()
    assert np.linalg.norm(error[:3]) < 0.15e-3
    assert np.degrees(np.linalg.norm(error[3:])) < 0.2


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("tilt_deg", [-5.0, 5.0])
def test_the_board_is_found_if_the_guess_is_tilted_by_five_degrees(view, axis, tilt_deg):
    scene, _, camera, image = view
    tilt = np.zeros(6)
    tilt[3 + axis] = np.radians(tilt_deg)
    found = find_board(image, camera.T_world_camera, scene.board, scene.T_world_board @ SE3.exp(tilt))
    assert isinstance(found, SE3)
    error = (scene.T_world_board.inverse() @ found).log()
    assert np.linalg.norm(error[:3]) < 0.15e-3 and np.degrees(np.linalg.norm(error[3:])) < 0.2


def test_no_board_is_said(view):
    scene, _, camera, image = view
    away = SE3.from_parts(translation_m=[0, 0, 0.08])
    assert "no plate" in find_board(image, camera.T_world_camera, scene.board, away)


def test_a_knocked_over_block_is_no_block(view):
    scene, pegs, camera, _ = view
    model, data = world_of(scene)
    on_its_side = SE3.exp([0, 0, 0, np.pi / 2, 0, 0]).rotation.as_quaternion()
    data.qpos[3:7] = on_its_side
    data.qpos[:3] += [0.0, 0.0, -0.006]

    mujoco.mj_forward(model, data)
    lying = overhead(model).render(data, np.random.default_rng(0))
    T_camera_board = camera.T_world_camera.inverse() @ scene.T_world_board
    assert isinstance(find_block(lying, T_camera_board, scene.board, scene.block, int(pegs[0])), str)


@pytest.mark.parametrize(("tilt_deg", "seen"), [(0.0, True), (8.0, True), (11.0, True), (25.0, False)])
def test_a_block_in_the_air_is_seen_as_far_tilted_as_jaws_hold_it(tilt_deg, seen):
    tilt = SE3.from_parts(SO3.axis("x", np.radians(tilt_deg)))
    T_board_block = standing(4, (1e-3, -2e-3), 0.4, height_m=0.037) @ tilt
    scene, rng = scene_of(T_board_block), np.random.default_rng(5)
    model, data = world_of(scene)
    camera = overhead(model)
    expected = SE3.from_parts(translation_m=[0.4e-3, -0.3e-3, 0.0]) @ T_board_block
    T_camera_board = camera.T_world_camera.inverse() @ scene.T_world_board
    found = find_held_block(camera.render(data, rng), T_camera_board, scene.block, expected)
    assert isinstance(found, SE3) == seen, found
    if isinstance(found, SE3):
        error = T_board_block.inverse() @ found
        assert np.linalg.norm(error.translation_m) < 0.4e-3
        assert error.matrix[2, 2] > np.cos(np.radians(1))


def test_refuses_bad_input(view):
    scene, _, camera, image = view
    pose = camera.T_world_camera.inverse() @ scene.T_world_board
    with pytest.raises(TrocarError, match="number is 12; the board has pegs 0 to 11"):
        find_block(image, pose, scene.board, scene.block, 12)
