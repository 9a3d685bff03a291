"""A path may be a string or a ``Path`` everywhere; and no message advises deleting a file."""

import ast
import re
from pathlib import Path

import pytest

from trocar.errors import TrocarError
from trocar.eval.trial import Trial

SOURCE = Path(__file__).parents[1] / "src" / "trocar"


def test_a_trial_that_is_not_there_is_said_to_be_missing_whatever_its_path_is(tmp_path):
    for path in (tmp_path / "none.npz", str(tmp_path / "none.npz")):
        with pytest.raises(TrocarError, match="does not exist"):
            Trial.load(path)


def public_functions():
    """Yield (file, function) of all that is public; of the tasks' own folders, what the documented API names."""
    api = re.findall(r"^::: (\S+)", (SOURCE.parents[1] / "docs" / "api.md").read_text(), re.MULTILINE)
    for file in sorted(SOURCE.rglob("*.py")):
        inside = file.relative_to(SOURCE).with_suffix("").parts
        module = ".".join(("trocar", *inside)).removesuffix(".__init__")
        # Typer gives the command line what it needs, and we call the reports and studies of tasks
        if inside[0] == "cli" or inside in (("eval", "task_report"), ("eval", "study")):
            continue
        if inside[0] == "tasks" and not any(name.startswith(module) for name in api):
            continue
        pending = list(ast.parse(file.read_text()).body)
        while pending:
            node = pending.pop()
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                pending += node.body
            if isinstance(node, ast.FunctionDef) and (node.name == "__init__" or not node.name.startswith("_")):
                yield file, node


def test_every_public_function_takes_paths_as_texts_too():
    """And does the same with them: pyright refuses a text used as a ``Path`` (``make lint``)."""
    found = []
    for file, function in public_functions():
        for argument in (*function.args.args, *function.args.kwonlyargs):
            kind = "" if argument.annotation is None else ast.unparse(argument.annotation)
            if re.search(r"\bPath\b", kind) and not re.search(r"\bstr\b", kind):
                found.append(f"{file.relative_to(SOURCE)}: {function.name}({argument.arg}: {kind})")
    assert not found


def test_no_sentence_advises_to_delete_a_file():
    advice = re.compile(
        r"\bdelet|\berase|\brm -|\bthrow (it|them) away|\bremove (it|the (file|folder))\b", re.IGNORECASE
    )
    found = []
    for file in sorted(SOURCE.rglob("*.py")):
        if not advice.search(text := file.read_text()):
            continue
        tree = ast.parse(text)
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            spoken = isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
            if spoken and advice.search(node.value):
                found.append(f"{file.relative_to(SOURCE)}:{node.lineno} {node.value!r:.80}")
    assert not found
