"""Charged fragments come off the jaws: real physics, with perception given what a finger touches."""

from dataclasses import replace
from types import SimpleNamespace

import trio

from debridement_stage import Eyes, play
from trocar.tasks.debridement.agents.letting_go import SHAKEN_RAD, STROKES, WAYS, try_to_shed

CLING_N, DENSITY_KG_M3 = 1.4e-3, 160.0


class Touching(Eyes):
    def holding(self, image, T_world_camera, model, T_world_tip, jaw_rad):
        return bool(self.lab.truth().touched_by[self.arm_of(model)][-1].any())


def charged(scene):
    light = [replace(f, cling_n=CLING_N, density_kg_m3=DENSITY_KG_M3) for f in scene.fragments]
    return replace(scene, fragments=tuple(light))


def test_a_fragment_that_both_fingers_draw_up_between_them_comes_off(monkeypatch, tmp_path):
    trial = play(monkeypatch, tmp_path, Touching(), seed=4, change=charged, arms=1, fragments=1, budget_s=120.0)
    *_, said = [e for e in trial.events if e["name"] == "fragment"]  # one that falls beside the receptacle comes again
    *_, released = [e for e in trial.events if e["name"] == "releasing"]
    assert said["time_s"] - released["time_s"] > 1.0, "it clung"
    assert trial.scores[0]["succeeded"] and said["outcome"] == "DONE"


def test_what_has_not_helped_in_one_way_is_tried_in_another():
    done = []

    class Arm:
        places = SimpleNamespace(table_m=-0.162)

        async def jaw(self, angle_rad):
            done.append(("jaw", angle_rad))

        async def rise(self, by_m):
            done.append(("rise", by_m))

        async def stroke(self, height_m, open_rad):
            done.append(("stroke", height_m, open_rad))

    async def shed():
        for number in range(WAYS):
            await try_to_shed(Arm(), number)
            assert done[-1] == ("jaw", SHAKEN_RAD), "a fragment is looked for at jaws that are wide open"

    trio.run(shed)
    strokes = [way for way in done if way[0] == "stroke"]
    assert len(strokes) == len(set(strokes)) == len(STROKES)
    assert all(0.010 < height_m + 0.162 < 0.015 for _, height_m, _ in strokes), "over the receptacle's floor"
