import pytest
from typer.main import get_command
from typer.testing import CliRunner

from trocar.cli import app


def leaves(command, path=()):
    """Return the words of every command under this one."""
    children = getattr(command, "commands", {})
    return [path] if not children else [leaf for name in children for leaf in leaves(children[name], (*path, name))]


COMMANDS = leaves(get_command(app))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example_of_itself(words):
    result = CliRunner().invoke(app, [*words, "--help"])
    assert result.exit_code == 0
    text = " ".join(result.output.split())
    assert f"Example: trocar {' '.join(words)}" in text


@pytest.mark.parametrize("words", [words for words in COMMANDS if words != ("doctor",)], ids=" ".join)
def test_every_command_that_computes_has_json(words):
    assert "--json" in CliRunner().invoke(app, [*words, "--help"]).output


def test_no_words_print_the_commands():
    result = CliRunner().invoke(app, [])
    assert all(words[0] in result.output for words in COMMANDS)
