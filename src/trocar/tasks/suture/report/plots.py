"""What ``trocar.report.plot.plot`` draws of suture plans."""

from __future__ import annotations

from trocar.errors import TrocarError
from trocar.report.style import Picture, picture
from trocar.tasks.suture.planning import DexterityMap, SuturePlan
from trocar.tasks.suture.report.plan.circle import circle


def _dexterity(thing: DexterityMap, plan: SuturePlan | None = None, title: str = "") -> Picture:
    return picture(lambda figure: circle(figure, thing, plan, title))


def _sutures(thing: SuturePlan, map: DexterityMap | None = None, title: str = "") -> Picture:
    if map is None:
        raise TrocarError("a plan of sutures is drawn on its dexterity map; give plot(plan, map=map)")
    return _dexterity(map, thing, title)


PLOTS = {DexterityMap: _dexterity, SuturePlan: _sutures}
