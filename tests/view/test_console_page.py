"""A live page with controls, without a browser: wishes are passed on at once, in order and with their values."""

import numpy as np
import pytest

pytest.importorskip("viser")
from live_scene import MadeUpScene, console_moment
from visitor import busy, visitor_of

from trocar.view.console_view import ConsoleView
from trocar.view.wishes import Level, Wish

AT_REST = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.fixture
def page():
    said = []
    view = ConsoleView(MadeUpScene(), "made up", console_moment(0), port=0, say=said.append)
    with visitor_of(view.server) as visitor:
        yield view, visitor, said
    view.close()


@pytest.mark.parametrize(
    ("menu", "chosen", "wish", "value"),
    [("_level", Level.GOALS.value, Wish.LEVEL, Level.GOALS), ("_speed", "x 4", Wish.SPEED, 4.0)],
)
def test_a_choice_is_passed_on_though_the_next_moment_sets_the_menu_back(page, menu, chosen, wish, value):
    view, visitor, said = page
    with busy(view.server):
        visitor.choose(getattr(view, menu), chosen)
        view.show(console_moment(1))
    assert [(one.wish, one.value) for one in said] == [(wish, value)]


def test_a_handle_is_let_go_after_it_was_held_at_each_of_its_places(page):
    view, visitor, said = page
    view.show(console_moment(1, hands={"psm1": AT_REST}))
    places_m = [(0.01 * k, 0.0, 0.0) for k in range(1, 5)]
    with busy(view.server):
        visitor.drag("/handles/psm1", places_m)
    assert [one.wish for one in said] == [Wish.HOLD] * 5 + [Wish.RELEASE]
    assert [tuple(one.value.position_m) for one in said[:-1]] == [AT_REST[0], *places_m]
    assert {one.arm for one in said} == {"psm1"}


def test_the_table_of_flaws_is_written_only_when_they_change(page):
    view, _, _ = page
    view.show(console_moment(1, flaws={"lens": "2 px"}))
    assert "lens" in view._flaws.content and "2 px" in view._flaws.content
    view._flaws.content = "as it was"
    view.show(console_moment(2, flaws={"lens": "2 px"}))
    assert view._flaws.content == "as it was"
    view.show(console_moment(3, flaws={"lens": "3 px"}))
    assert "3 px" in view._flaws.content


def test_the_path_of_a_motion_is_drawn_until_it_has_ended(page):
    view, *_ = page
    path_m = np.linspace([0.0, 0.0, 0.0], [0.01, 0.02, 0.03], 5)

    def drawn():
        return view.server.scene._handle_from_node_name.get("/paths/psm1")

    view.show(console_moment(1, paths={"psm1": path_m}))
    first = drawn()
    np.testing.assert_allclose(first.points[-1, 1], path_m[-1], atol=1e-6)
    view.show(console_moment(2, paths={"psm1": path_m.copy()}))
    assert drawn() is first, "nothing is sent again"
    view.show(console_moment(3, paths={"psm1": path_m + 0.01}))
    np.testing.assert_allclose(drawn().points[-1, 1], path_m[-1] + 0.01, atol=1e-6)
    view.show(console_moment(4))
    assert drawn() is None
