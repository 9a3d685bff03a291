import sys

import pytest

from trocar.cli import main


@pytest.fixture
def trocar(monkeypatch, capsys):
    """Run a command in this process; return exit code, stdout and stderr."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["trocar", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        out = capsys.readouterr()
        return stop.value.code or 0, out.out, out.err

    return command
