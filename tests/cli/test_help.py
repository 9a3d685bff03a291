"""Help: every command has it, with an example."""

import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from trocar.cli import app
from trocar.cli.commands import COMMANDS as KNOWN
from trocar.cli.group import Deferred, Group
from trocar.eval import TASKS
from trocar.registry import Lazy

RUNNER = CliRunner()
WIDE = {"COLUMNS": "200", "TERM": "dumb"}
WITHOUT_JSON = {("doctor",), ("view",)}


def leaves(command, path=()):
    """Return the words of every command under this one, those included that are made when they are asked for."""
    command = command.load() if isinstance(command, Deferred) else command
    if not hasattr(command, "list_commands"):
        return [path]
    children = {name: command.get_command(None, name) for name in command.list_commands(None)}
    return [leaf for name, child in children.items() for leaf in leaves(child, (*path, name))]


COMMANDS = leaves(get_command(app))


def test_the_whole_tree_is_walked():
    """Commands of tasks, and those that a task brings along, are made when they are asked for."""
    assert {("run", task) for task in TASKS} <= set(COMMANDS)
    assert {("register", "block"), ("station", "check"), ("study", "suture"), ("plan", "setup")} <= set(COMMANDS)
    assert len(COMMANDS) == len(set(COMMANDS)) >= 17


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example_of_itself_and_json_if_it_computes(words):
    short, long = (RUNNER.invoke(app, [*words, option], env=WIDE) for option in ("-h", "--help"))
    assert short.exit_code == long.exit_code == 0 and short.output == long.output
    assert f"Example: trocar {' '.join(words)}" in " ".join(long.output.split())
    assert "--json" in long.output or words in WITHOUT_JSON or words[0] == "console"


def test_the_version_is_that_of_the_package_and_the_package_is_a_command():
    found = subprocess.run([sys.executable, "-m", "trocar", "--version"], capture_output=True, text=True, check=True)
    assert found.stdout == f"trocar {version('trocar')}\n"


def test_no_words_print_the_commands():
    result = RUNNER.invoke(app, [], env=WIDE)
    assert all(words[0] in result.output for words in COMMANDS)


@pytest.mark.parametrize("group", sorted({words[0] for words in COMMANDS if len(words) == 2}))
def test_a_group_prints_its_commands(group):
    result = RUNNER.invoke(app, [group], env=WIDE)
    own = [words[1] for words in COMMANDS if words[0] == group]
    assert own and all(name in result.output for name in own)


LISTS = ["--help", "--version", "calibrate --help", "plan --help", "station --help"]


def test_what_only_lists_commands_imports_nothing_that_computes():
    """In a fresh interpreter: importing NumPy and SciPy takes ten times as long as printing the help."""
    code = (
        "import contextlib, io, sys\n"
        "from trocar.cli import main\n"
        f"for line in {LISTS}:\n"
        "    sys.argv = ['trocar', *line.split()]\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):\n"
        "        main()\n"
        "    assert said.getvalue()\n"
        "    print(line, *{'numpy', 'scipy', 'matplotlib', 'mujoco', 'rich.table'} & set(sys.modules), sep='|')\n"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == LISTS


def known_leaves(members):
    return [leaf for known in members.values() for leaf in (known_leaves(known.members) or [known])]


@pytest.mark.parametrize("known", known_leaves(KNOWN), ids=lambda known: known.where)
def test_the_line_in_the_list_is_the_first_of_the_commands_own_help(known):
    found = Lazy(known.where).load()
    own = found.help if isinstance(found, Group) else found.__doc__
    assert " ".join(own.split("\n\n")[0].split()) == known.about
