"""The domain in which a station's topics are."""

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.bus import domain_of
from trocar.errors import InvalidValue
from trocar.lab.topics import Topics


@pytest.mark.parametrize(("told", "domain"), [(None, 0), ("", 0), (" ", 0), ("0", 0), ("42", 42), ("232", 232)])
def test_the_domain_is_the_environments_unless_the_station_has_its_own(monkeypatch, told, domain):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    if told is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", told)
    assert domain_of(Topics()) == domain
    assert domain_of(Topics(domain=7)) == 7


@pytest.mark.parametrize("told", ["lab", "-1", "233", "3.0"])
def test_what_is_no_domain_is_one_sentence(monkeypatch, told):
    monkeypatch.setenv("ROS_DOMAIN_ID", told)
    with pytest.raises(InvalidValue, match=f"ROS_DOMAIN_ID is {told}; set it to 0 to 232"):
        domain_of(Topics())
