import pytest

from trocar.counting import counted


@pytest.mark.parametrize(
    ("given", "said"), [((0, "trial"), "0 trials"), ((1, "trial"), "1 trial"), ((2, "box", "boxes"), "2 boxes")]
)
def test_one_thing_takes_no_s(given, said):
    assert counted(*given) == said
