"""Find small mistakes that the tests would miss: break one token at a time and run the tests of that file.

    make mutants                                              # 30 mutants of what moves, sees and simulates
    python benchmarks/mutants.py --count 300 --seed 1         # more; the same command resumes where it stopped
    python benchmarks/mutants.py --changed                    # of files that are not as in the last commit
    python benchmarks/mutants.py src/trocar/arms/inverse.py   # of a file or a folder

A mutant swaps an operator, a comparison, ``and`` for ``or``, ``min`` for ``max``, ``sin`` for ``cos``, drops a sign or
a ``not``, or changes a number. It is made in a copy of the tree, in which the test file that mirrors the mutated file
runs, and those that use it most. A mutant is killed if a test fails that passes without it, or takes too long. Mutants
that survive are printed: some change nothing that matters; the others are mistakes that the tests would miss.

Existing tools do not fit: mutmut (3.8) draws no sample, and first runs the whole suite to see which tests call what;
cosmic-ray (8.7) runs one command for all files, in the tree itself; neither swaps sine and cosine.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import io
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parents[1]
DEFAULT = [f"src/trocar/{name}" for name in ("arms", "motion", "calibration", "perception", "robots", "sim")]
PARTS = ("src", "tests", "benchmarks", "tools", "examples", "docs")
PARTS += ("pyproject.toml", "README.md", "Makefile", "mkdocs.yml")
"""Parts of the tree that the tests need."""
MORE_TESTS = 2
"""Number of test files beside the mirror of a file: those that use its names most."""
WHOLE_RUNS = ("tests/cli", "tests/eval", "tests/test_examples.py")
"""End-to-end tests, which run only if they mirror the file: they notice much, but take minutes."""
SKIPPED = ast.Import | ast.ImportFrom | ast.Raise | ast.JoinedStr
PAIRS = ["+ -", "* /", "** *", "// /", "% *", "< <=", "> >=", "== !=", "and or", "+= -=", "*= /=", "True False"]
PAIRS += ["min max", "minimum maximum", "argmin argmax", "nanmin nanmax", "any all", "sin cos", "arcsin arccos"]
PAIRS += ["floor ceil", "upper lower", "left right", "sum max", "mean median", "in not_in", "is is_not"]
SWAPS = {a: b.replace("_", " ") for pair in PAIRS for a, b in (pair.split(), pair.split()[::-1]) if "_" not in a}
SWAPS |= {"**": "*", "*": "/", "/": "*", "max": "min", "not": ""}


@dataclass(frozen=True)
class Mutant:
    """One token of a file replaced; ``start`` and ``end`` are its byte offsets, ``digest`` is the file's."""

    path: str
    digest: str
    line: int
    start: int
    end: int
    old: str
    new: str

    def applied(self, source: bytes) -> bytes:
        """Return the file with this mistake."""
        return source[: self.start] + self.new.encode() + source[self.end :]

    def diff(self) -> str:
        """Return the line before and after, as one text."""
        source = (ROOT / self.path).read_bytes()
        line = source.splitlines()[self.line - 1].decode().strip()
        broken = self.applied(source).splitlines()[self.line - 1].decode().strip()
        return f"{self.path}:{self.line}\n    - {line}\n    + {broken}"


def alive(tree: ast.AST) -> Iterator[ast.AST]:
    """Walk the nodes that affect behaviour: no annotations, decorators, imports, messages or errors."""
    for field, value in ast.iter_fields(tree):
        if field in {"annotation", "returns", "decorator_list", "type_params"}:
            continue
        for node in value if isinstance(value, list) else [value]:
            if isinstance(node, ast.AST) and not isinstance(node, SKIPPED):
                yield node
                yield from alive(node)


def spans_of(node: ast.AST) -> list[tuple[ast.expr | None, ast.expr | None]]:
    """Return pairs of parts between which a node's own tokens stand; None: the node's beginning or end."""
    found: list[tuple[ast.expr | None, ast.expr | None]] = []
    match node:
        case ast.BinOp(left=a, right=b) | ast.AugAssign(target=a, value=b):
            found = [(a, b)]
        case ast.Compare(left=a, comparators=rest):
            found = [*pairwise([a, *rest])]
        case ast.BoolOp(values=values):
            found = [*pairwise(values)]
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            found = [(None, operand)]
        case ast.Attribute(value=value):
            found = [(value, None)]
        case ast.Name() | ast.Constant(value=bool() | int() | float()):
            found = [(None, None)]
    return found


def digest_of(content: bytes) -> str:
    """Return a short digest of a file's content."""
    return hashlib.sha256(content).hexdigest()[:12]


def number(text: str) -> str:
    """Return a different number: the next integer, or twice a float."""
    value = ast.literal_eval(text)
    return str(value + 1) if isinstance(value, int) else repr(2 * value or 1.0)


def mutants_of(path: Path) -> list[Mutant]:
    """Return every mutant of a file."""
    source = path.read_bytes()
    begins = [0, *(match.end() for match in re.finditer(rb"\n", source))]
    tokens = []
    for token in tokenize.tokenize(io.BytesIO(source).readline):
        if token.type in (tokenize.OP, tokenize.NAME, tokenize.NUMBER):
            start = begins[token.start[0] - 1] + len(token.line[: token.start[1]].encode())
            tokens.append((start, token.string, token.start[0], token.type))
    found = {}

    def ends(node: ast.expr | ast.stmt) -> tuple[int, int]:
        last = begins[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        return begins[node.lineno - 1] + node.col_offset, last

    for node in alive(ast.parse(source)):
        for a, b in spans_of(node):
            assert isinstance(node, ast.expr | ast.stmt)  # so are all that have spans
            first, last = ends(a)[1] if a else ends(node)[0], ends(b)[0] if b else ends(node)[1]
            inside = [token for token in tokens if first <= token[0] < last and token[1] not in "()."]
            start, text, line, kind = inside[0] if inside else (0, "", 0, 0)
            lone = isinstance(node, ast.UnaryOp) or [token[1] for token in inside] in (["not", "in"], ["is", "not"])
            if lone and text == "is":
                start, text, line, kind = inside[1]
            new = "" if lone and text in {"-", "not"} else number(text) if kind == tokenize.NUMBER else SWAPS.get(text)
            if new is not None:
                place = str(path.relative_to(ROOT)), digest_of(source), line
                found[start] = Mutant(*place, start, start + len(text.encode()), text, new)
    return [found[start] for start in sorted(found)]


def imports_of(path: Path) -> Counter[str]:
    """Return how often a test file uses each module of Trocar, by the module that defines a name."""
    tree, used = ast.parse(path.read_text()), Counter()
    names = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("trocar"):
            for alias in node.names:
                used[_home(node.module, alias.name)] += 1 + names[alias.asname or alias.name]
    return used


def _home(module: str, name: str) -> str:
    """Return the module that defines a name, which a package may re-export."""
    folder, source = ROOT / "src" / module.replace(".", "/"), ""
    if (folder / f"{name}.py").is_file() or (folder / name).is_dir():
        return f"{module}.{name}"
    if (folder / "__init__.py").is_file():
        source = (folder / "__init__.py").read_text()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and name in {alias.asname or alias.name for alias in node.names}:
            return _home(str(node.module), name)
    return module


def tests_of(path: str, used: dict[Path, Counter[str]]) -> list[str]:
    """Return the test files for a source file, its mirror first; if there are none, those of the nearest folder."""
    inner = Path(path).relative_to("src/trocar").with_suffix("")
    module = ".".join(("trocar", *inner.parts)).removesuffix(".__init__")
    mirror = ROOT / "tests" / inner.parent / f"test_{inner.name}.py"
    users = sorted((test for test in used if used[test][module]), key=lambda test: (-used[test][module], test))
    others = [test for test in users if test != mirror and not str(test.relative_to(ROOT)).startswith(WHOLE_RUNS)]
    chosen = [mirror] * mirror.is_file() + others[:MORE_TESTS]
    for folder in (ROOT / "tests" / inner).parents:
        chosen = chosen or sorted(folder.glob("test_*.py"))
    return [str(test.relative_to(ROOT)) for test in chosen]


def passed(tree: Path, tests: Iterable[str], limit_s: int) -> tuple[bool, str]:
    """Return whether tests pass in a tree within ``limit_s`` of CPU time, and what failed first."""
    data = os.environ.get("TROCAR_DATA", ROOT.parent / "shared" / "data")  # beside the tree, not beside its copy
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "TROCAR_DATA": str(data)}
    words = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no", *tests]
    limit = resource.RLIMIT_CPU, (limit_s, limit_s + 5)
    try:
        done = subprocess.run(
            words,
            cwd=tree,
            env=environment,
            preexec_fn=lambda: resource.setrlimit(*limit),
            capture_output=True,
            text=True,
            check=False,
            timeout=20 * limit_s,
        )
    except subprocess.TimeoutExpired:
        done = subprocess.CompletedProcess(words, -1)
    if done.returncode < 0:  # ended by the limit
        return False, "too long"
    failed = re.search(r"^(?:FAILED|ERROR) (\S+?(?:::.*?)?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return done.returncode == 0, failed[1] if failed else done.stdout[-300:]


def tried(mutant: Mutant, tree: Path, tests: list[str], limit_s: int, sound: dict[str, bool], stamp: int) -> str:
    """Return 'survived', or what killed the mutant; ``sound`` holds which tests pass without it."""
    file, source = tree / mutant.path, (ROOT / mutant.path).read_bytes()
    try:
        file.write_bytes(mutant.applied(source))
        os.utime(file, (stamp, stamp))  # else Python may use the bytecode of the mutant before
        well, failed = passed(tree, tests, limit_s)
    finally:
        file.write_bytes(source)
        os.utime(file, (stamp + 1, stamp + 1))
    guilty = [failed] if failed.startswith("tests/") else [] if well else tests  # all of them, if they took too long
    name = " ".join(guilty)
    if guilty and name not in sound:
        sound[name] = passed(tree, guilty, limit_s)[0]
    if not sound.get(name, True):
        raise SystemExit(f"without any mutant, {name} fails too, or takes longer than --limit; mend that first")
    return "survived" if well else failed


def copied(tree: Path) -> Path:
    """Make a copy of what the tests need."""
    tree.mkdir()
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, tree / part)
    return tree


def chosen_files(words: list[str], changed: bool) -> list[Path]:
    """Return the source files that are asked for."""
    if changed:
        git = ["git", "diff", "--name-only", "--diff-filter=d", "HEAD", "--", "src/trocar"]
        words = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    found = [ROOT / word for word in (words or ([] if changed else DEFAULT))]
    return sorted({file for path in found for file in (path.rglob("*.py") if path.is_dir() else [path])})


def main() -> None:
    """Try a sample of mutants and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", help="source files or folders")
    parser.add_argument("--changed", action="store_true", help="files that differ from the last commit")
    parser.add_argument("--count", type=int, default=30, help="so many mutants, drawn at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=int, default=120, help="CPU seconds of the tests of one mutant")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="so many at a time, one for each core")
    parser.add_argument("--log", type=Path, default=ROOT / "out" / "mutants.jsonl", help="what was tried before")
    given = parser.parse_args()
    mutants = [mutant for file in chosen_files(given.files, given.changed) for mutant in mutants_of(file)]
    sample = random.Random(given.seed).sample(mutants, min(given.count, len(mutants)))
    given.log.parent.mkdir(parents=True, exist_ok=True)
    lines = given.log.read_text().splitlines() if given.log.is_file() else []
    known = {(Mutant(**entry["mutant"]), entry["tests"]): entry["fate"] for entry in map(json.loads, lines)}
    used = {path: imports_of(path) for path in (ROOT / "tests").rglob("test_*.py")}
    fates, sound, trees = {}, {}, Queue()

    def fate_of(count: int, mutant: Mutant) -> None:
        tests = tests_of(mutant.path, used)
        digest = digest_of(b"".join((ROOT / test).read_bytes() for test in tests))
        fates[mutant] = known.get((mutant, digest), "")
        if not fates[mutant]:
            tree = trees.get()
            try:
                fates[mutant] = tried(mutant, tree, tests, given.limit, sound, 1_000_000_000 + 2 * count)
            finally:
                trees.put(tree)
            entry = {"mutant": asdict(mutant), "tests": digest, "fate": fates[mutant]}
            with given.log.open("a") as log:
                log.write(json.dumps(entry) + "\n")
        change = f"{mutant.old} -> {mutant.new or 'nothing'}"
        print(f"{count} of {len(sample)}: {mutant.path}:{mutant.line} {change}: {fates[mutant]}", flush=True)

    with tempfile.TemporaryDirectory(prefix="mutants_") as folder, ThreadPoolExecutor(given.jobs) as pool:
        for job in range(given.jobs):
            trees.put(copied(Path(folder) / str(job)))
        tries = [pool.submit(fate_of, count, mutant) for count, mutant in enumerate(sample, 1)]
        try:
            for one in tries:
                one.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    survivors = [mutant for mutant, fate in fates.items() if fate == "survived"]
    print(f"\n{len(fates) - len(survivors)} of {len(fates)} mutants were killed; the others:")
    for mutant in sorted(survivors, key=lambda m: (m.path, m.line)):
        print(mutant.diff())


if __name__ == "__main__":
    main()
