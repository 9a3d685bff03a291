import pytest

from trocar.counting import counted


@pytest.mark.parametrize(("number", "said"), [(0, "0 trials"), (1, "1 trial"), (2, "2 trials")])
def test_one_thing_takes_no_s(number, said):
    assert counted(number, "trial") == said
