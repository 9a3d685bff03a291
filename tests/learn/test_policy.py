import json
import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

import trocar
from trocar.errors import BadFile, InvalidInput
from trocar.learn.policy import load_policy, policy_digest

SEEN = {"state": np.zeros(8, np.float32), "images_overhead": np.zeros((2, 3, 3), np.uint8)}
FILE = """
import numpy as np
def still(seen): return seen["state"]
def nan(seen): return np.full(8, np.nan)
def short(seen): return [0.0, 0.0]
def raises(seen): raise KeyError("weights")
def hangs(seen):
    import time
    time.sleep(3600)
def done(seen): return None
class Counting:
    def __init__(self): self.count = 0
    def __call__(self, seen):
        self.count += 1
        return self.count
number = 3
def __getattr__(name):
    if name != "slow": raise AttributeError(name)
    import time
    time.sleep(1.0)
    return still
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def test_a_class_begins_anew_in_each_trial(file):
    for _ in range(2):
        with load_policy(f"{file}:Counting") as ask:
            assert [ask(SEEN), ask(SEEN)] == [1, 2]


def test_a_folder_makes_its_policy(tmp_path):
    (tmp_path / "gain.txt").write_text("5")
    (tmp_path / "policy.py").write_text(
        "def make(folder):\n    gain = float((folder / 'gain.txt').read_text())\n    return lambda seen: gain\n"
    )
    with load_policy(str(tmp_path)) as ask:
        assert ask(SEEN) == 5.0


def test_a_policy_that_has_changed_is_another_one(tmp_path):
    (tmp_path / "policy.py").write_text("def make(folder):\n    return len\n")
    (tmp_path / "weights").write_bytes(b"1")
    before = policy_digest(str(tmp_path))
    (tmp_path / "weights").write_bytes(b"2")
    assert policy_digest(str(tmp_path)) != before
    with pytest.raises(InvalidInput, match="has changed since this run began"), load_policy(str(tmp_path), before):
        pass


def test_a_function_of_a_package_beside_which_one_works_is_no_folder(tmp_path, monkeypatch):
    (tmp_path / "policy_package").mkdir()
    (tmp_path / "policy_package" / "__init__.py").write_text("def act(seen):\n    return [len(seen)]\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert policy_digest("policy_package:act") == ""
    with load_policy("policy_package:act") as ask:
        assert ask(SEEN) == [len(SEEN)]


@pytest.mark.parametrize(
    ("name", "said"), [("raises", "raised KeyError: 'weights'"), ("hangs", "has not answered within 0.2 s")]
)
def test_a_policy_that_fails_is_a_sentence(file, name, said):
    with load_policy(f"{file}:{name}", timeout_s=0.2) as ask, pytest.raises(InvalidInput, match=said):
        ask(SEEN)


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        ("nowhere", "does not exist"),
        ("nowhere:act", "cannot be loaded: ModuleNotFoundError"),
        ("tcp://nobody", "is no address"),
        ("tcp://127.0.0.1:0", "is no address; give tcp://HOST:PORT, with a port of 1 to 65535"),
        ("tcp://127.0.0.1:70000", "is no address"),
        ("tcp://127.0.0.1:\u00b2", "is no address"),
        ("tcp://127.0.0.1:5/act", "is no address"),
        ("tcp://[::1:5", "is no address"),
        ("tcp://a..b:5", "does not answer"),
        ("tcp://127.0.0.1:1", "does not answer"),
        ("{file}:missing", "has no missing"),
        ("{file}:number", "is 3; give a function"),
    ],
)
def test_what_is_no_policy_is_refused(file, policy, said):
    with pytest.raises(InvalidInput, match=said), load_policy(policy.format(file=file)):
        pass


def test_a_folder_without_a_policy_is_refused(tmp_path):
    with pytest.raises(BadFile, match=r"has no policy\.py"):
        policy_digest(str(tmp_path))


def serve(answers, address="127.0.0.1"):
    """Answer one client, line by line; return the port and what it said."""
    server, heard = socket.create_server((address, 0), family=socket.getaddrinfo(address, 0)[0][0]), []

    def run():
        link = server.accept()[0]
        with link, link.makefile("rwb") as stream:
            heard.append(json.loads(stream.readline()))
            for answer in answers:
                heard.append(json.loads(stream.readline()))
                stream.write(answer + b"\n")
                stream.flush()

    threading.Thread(target=run, daemon=True).start()
    return server.getsockname()[1], heard


def test_a_server_is_asked_line_by_line():
    port, heard = serve([b'{"action": [1, 2]}', b'{"action": null}', b"what?"])
    with load_policy(f"tcp://127.0.0.1:{port}") as ask:
        assert ask(SEEN) == [1, 2]
        assert ask(SEEN) is None
        with pytest.raises(InvalidInput, match=r"said 'what\?'"):
            ask(SEEN)
        with pytest.raises(InvalidInput, match=r"hung up|is gone"):
            ask(SEEN)
    assert heard[0] == {"reset": True}
    assert heard[1]["observation"]["state"] == [0.0] * 8
    assert heard[1]["observation"]["images_overhead"]["shape"] == [2, 3, 3]


def test_a_server_is_found_by_ipv6():
    try:
        port, _ = serve([b'{"action": [1, 2]}'], "::1")
    except OSError:
        pytest.skip("this machine has no IPv6")
    with load_policy(f"tcp://[::1]:{port}") as ask:
        assert ask(SEEN) == [1, 2]


def test_a_server_that_hangs_up_at_once_is_named(monkeypatch):
    class Gone:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def settimeout(self, timeout_s):
            pass

        def sendall(self, line):
            raise BrokenPipeError("broken pipe")

    monkeypatch.setattr(socket, "create_connection", lambda *_: Gone())
    with (
        pytest.raises(InvalidInput, match=r"tcp://here:1' is gone: broken pipe; start its server again"),
        load_policy("tcp://here:1"),
    ):
        pass


def test_a_server_whose_answer_never_ends_is_not_waited_for():
    server = socket.create_server(("127.0.0.1", 0))

    def trickle():
        link = server.accept()[0]
        with suppress(OSError):
            while True:
                link.sendall(b" ")
                time.sleep(0.05)

    threading.Thread(target=trickle, daemon=True).start()
    began_s = time.monotonic()
    with (
        load_policy(f"tcp://127.0.0.1:{server.getsockname()[1]}", timeout_s=0.5) as ask,
        pytest.raises(InvalidInput, match=r"has not answered within 0\.5 s"),
    ):
        ask(SEEN)
    assert time.monotonic() - began_s < 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ended", "said"),
    [
        ("still", "OUT_OF_TIME", "had not finished after 1 s"),
        ("done", "done", ""),
        ("nan", "FAULT", "psm1_sp.position.x of the action is nan"),
        ("short", "FAULT", "has the shape (2,)"),
        ("raises", "FAULT", "raised KeyError: 'weights'"),
    ],
)
def test_a_policy_is_an_agent_whose_trials_are_kept(file, tmp_path, name, ended, said):
    policy = f"{file}:{name}"
    trials = trocar.run(
        "peg-transfer",
        transfers=1,
        budget_s=1.0,
        method="policy",
        settings={"policy": policy, "policy_digest": policy_digest(policy)},
        out=tmp_path / "out",
    )
    (trial,) = trials
    assert trial.ended == ended and said in trial.reason
    assert len(trial.scores) == 1 and not trial.scores[0]["succeeded"]
    asked = sum(one.name == "policy" for one in trial.computations)
    assert asked == {"still": 30, "raises": 0}.get(name, 1), "thirty times a second"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "policy"], "names no policy; give --policy"),
        (["--policy", "{file}:still"], "give --method policy or policy-calibrated"),
        (["--method", "policy", "--policy", "{file}:missing"], "has no missing"),
        (["--method", "policy", "--policy", "{file}:slow", "--set", "timeout_s=0.2"], "has not answered within 0.2 s"),
        (
            ["--method", "policy", "--policy", "{file}:still", "--set", "timeout_s=0"],
            "'timeout_s' is 0.0; give seconds",
        ),
    ],
)
def test_the_command_line_refuses_before_anything_is_written(trocar, file, tmp_path, words, said):
    out = tmp_path / "out"
    code, _, err = trocar("run", "peg-transfer", "--out", out, *(word.format(file=file) for word in words))
    assert code == 2 and said in err
    assert not out.exists()
