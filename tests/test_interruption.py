"""A Ctrl-C that something swallows is raised at the next check."""

import gc
import signal
import threading

import pytest

from trocar.interruption import CtrlC, interrupts


class PressedInDestructor:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_an_interruption_in_a_destructor_comes_at_the_next_check():
    reached = []
    with pytest.raises(KeyboardInterrupt), CtrlC() as ctrl_c:
        ctrl_c.check()
        thing = PressedInDestructor()
        del thing
        gc.collect()
        reached.append("swallowed")
        ctrl_c.check()
        reached.append("lost")
    assert reached == ["swallowed"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_it_is_raised_at_once_elsewhere():
    with pytest.raises(KeyboardInterrupt), CtrlC():
        signal.raise_signal(signal.SIGINT)
        pytest.fail("nothing was raised")


def test_a_handler_of_somebody_else_stays():
    pressed = []
    before = signal.signal(signal.SIGINT, lambda *_: pressed.append(1))
    try:
        assert not interrupts()
        with CtrlC() as ctrl_c:
            signal.raise_signal(signal.SIGINT)
            ctrl_c.check()
    finally:
        signal.signal(signal.SIGINT, before)
    assert pressed == [1]


def test_other_threads_are_not_interrupted():
    found = []
    thread = threading.Thread(target=lambda: found.append(interrupts()))
    thread.start()
    thread.join()
    assert found == [False]
    assert interrupts()
