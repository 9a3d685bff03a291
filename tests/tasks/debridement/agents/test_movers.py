import pytest

from trocar.tasks.debridement.agents.movers import names_another_arm


@pytest.mark.parametrize(
    ("reason", "arm", "another"),
    [
        ("at the start, left right finger is 1 mm from receptacle 0 4, not 4.00 mm", "left", False),
        ("at the start, right left finger is 1 mm from table, not 4.00 mm", "right", False),
        ("at the start, left right finger is 1 mm from right left finger, not 4.00 mm", "left", True),
        ("left wrist comes within 1 mm of right shaft after 0.3 s", "right", True),
    ],
)
def test_a_finger_on_the_other_side_is_not_the_other_arm(reason, arm, another):
    """Arms and fingers are both called left and right; an arm at the receptacle's wall would go aside, not up."""
    assert names_another_arm(reason, arm, ("left", "right")) is another
