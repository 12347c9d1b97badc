"""The documents say what is: paths, links, commands, answers and names in README.md and docs/ are real."""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from cellctl.__main__ import COMMANDS
from cellctl.api import schemas
from cellctl.api.problems import Problem
from cellctl.recipe import Recipe, load_recipe
from cellctl.recipe_checks import CHECK_NAMES
from cellctl.states import State
from hal.fake.joints.gun_bench import GunBench

ROOT = Path(__file__).parents[1]
GUIDES = ROOT / "docs" / "guide"
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TOP = ("cellctl", "deploy", "docs", "hal", "recipes", "tests")
"""Folders whose paths are looked up; `data/` is made by the service."""
SUFFIXES = (".py", ".toml", ".json", ".md", ".js", ".html")
MADE_BY_READER = ("cold.toml", "scan.html", "scans.html")
ROTOR_FACE_MM = 400.0
NAMES = [str(path.relative_to(ROOT)) for path in DOCUMENTS]
every_document = pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)


def blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def code_lines(text: str) -> list[str]:
    """Lines of indented and fenced code; a trailing backslash joins two."""
    fenced = [line for block in re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
              for line in block.splitlines()]  # fmt: skip
    indented = [line.strip() for line in text.replace("\\\n", " ").splitlines() if line.startswith("    ")]
    return indented + fenced


def inline(text: str) -> list[str]:
    """Inline code, fenced blocks apart."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE))


def commands(text: str) -> Iterator[list[str]]:
    """Command lines of cellctl, word by word; inline code that only names a command is none."""
    for line in [*code_lines(text), *inline(text)]:
        words = shlex.split(line, comments=True) if line.startswith(("cellctl ", ".venv/bin/cellctl ")) else []
        if len(words) > 2 and not words[1].endswith(":"):  # that is what a command says
            yield words[1:]


def parser() -> argparse.ArgumentParser:
    """The real one, with every command."""
    made = argparse.ArgumentParser("cellctl")
    subparsers = made.add_subparsers(dest="command", required=True)
    for name in COMMANDS:
        importlib.import_module(f"cellctl.cli.{name}").add_parser(subparsers)
    return made


def found(word: str) -> bool:
    """Whether a word that looks like a path of this repository is one; a module may stand without its suffix."""
    if word.startswith(tuple(f"{top}/" for top in TOP)):
        return any(ROOT.glob(word.rstrip("/"))) or (ROOT / f"{word}.py").exists()
    if re.fullmatch(r"[\w\-]+\.\w+", word) and word.endswith(SUFFIXES):
        return word in MADE_BY_READER or (ROOT / word).exists() or any(any((ROOT / top).rglob(word)) for top in TOP)
    return True


def anchors(path: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@every_document
def test_every_relative_link_leads_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        path = document.parent / name if name else document
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), target


@every_document
def test_every_path_exists(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    words = [*inline(text), *(word for line in code_lines(text) for word in line.split())]
    missing = [word for word in words if re.fullmatch(r"[\w./*\-]+", word) and not found(word)]
    assert not missing


@every_document
def test_every_command_line_parses(document: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in commands(document.read_text(encoding="utf-8")):
        try:
            parser().parse_args(words)
        except SystemExit:
            pytest.fail(f"cellctl {' '.join(words)}: {capsys.readouterr().err}")


@every_document
def test_every_target_of_make_exists(document: Path) -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    text = document.read_text(encoding="utf-8")
    asked = {found[1] for line in [*code_lines(text), *inline(text)] if (found := re.match(r"make ([a-z]+)", line))}
    assert asked <= targets


def test_commands_are_found_in_the_documents() -> None:
    seen = {words[0] for document in DOCUMENTS for words in commands(document.read_text(encoding="utf-8"))}
    assert seen >= {"run", "study", "measure", "validate", "verify", "report"}


@every_document
def test_code_in_python_compiles(document: Path) -> None:
    for block in blocks(document.read_text(encoding="utf-8"), "python"):
        tree = ast.parse(block)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(("cellctl", "hal")):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names), ast.unparse(node)


def test_answers_have_the_fields_of_the_schema() -> None:
    answers: list[type[BaseModel]] = [Problem]
    answers += [model for model in vars(schemas).values() if isinstance(model, type) and issubclass(model, BaseModel)]
    documents = [json.loads(block) for block in blocks((GUIDES / "mes-integrator.md").read_text("utf-8"), "json")]
    assert len(documents) >= 6
    for document in documents:
        assert any(set(document) <= set(model.model_fields) for model in answers), document


def test_every_code_of_a_refusal_is_one() -> None:
    table = re.findall(r"^\| \d{3}[^|]*\|([^|]+)\|", (GUIDES / "mes-integrator.md").read_text("utf-8"), re.MULTILINE)
    codes = {code for cell in table for code in re.findall(r"`(\w+)`", cell)}
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "cellctl").rglob("*.py"))
    assert len(codes) > 15
    assert [code for code in sorted(codes) if f'"{code}"' not in source] == []


def test_every_kind_of_event_is_named() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "cellctl").rglob("*.py"))
    kinds = set(re.findall(r"\.publish\(\s*\"(\w+)\"", source))
    line = re.search(r"^Kinds are (.+?)\.", (GUIDES / "mes-integrator.md").read_text("utf-8"), re.MULTILINE)
    assert line is not None
    assert set(re.findall(r"`(\w+)`", line[1])) == kinds


def test_the_table_of_checks_is_whole() -> None:
    text = (GUIDES / "process-engineer.md").read_text(encoding="utf-8")
    table = text[text.index("| check |") : text.index("The formulas")]
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == sorted(CHECK_NAMES)


def test_every_section_of_a_recipe_is_explained() -> None:
    text = (GUIDES / "process-engineer.md").read_text(encoding="utf-8")
    assert [name for name in Recipe.model_fields if f"| `[{name}]` |" not in text] == []


def test_every_state_is_explained_to_the_operator() -> None:
    text = (GUIDES / "operator.md").read_text(encoding="utf-8")
    told = {name for row in re.findall(r"^\| ([A-Z][^|]+) \|", text, re.MULTILINE) for name in row.split(", ")}
    assert told == {str(state) for state in State}


def test_functions_of_the_walk_live_where_it_says() -> None:
    text = (GUIDES / "developer.md").read_text(encoding="utf-8")
    pairs = re.findall(r"`([\w/]+\.py)`,\s+`([\w.]+)`", text)
    assert len(pairs) >= 5
    for file, name in pairs:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        defined = {node.name for node in ast.walk(tree) if isinstance(node, kinds)}
        assert set(name.split(".")) <= defined, f"{file}: {name}"


@pytest.mark.parametrize(("column", "name"), [(0, "lpt_shaft_36"), (1, "compressor_drum_24")])
def test_feeds_follow_the_rule_of_the_guide(column: int, name: str) -> None:
    recipe = load_recipe(ROOT / "recipes" / f"{name}.toml")
    shaft, rotor, bench = recipe.shaft, recipe.rotor, GunBench()
    assert shaft is not None
    assert rotor is not None
    assert rotor.thread is not None
    length, depth, size = rotor.length_mm, shaft.depth_mm, rotor.thread.major_diameter_mm
    assert length is not None
    assert depth is not None
    meets = ROTOR_FACE_MM - length - (size - bench.hex_depth_mm) - bench.mouth_mm
    rests = ROTOR_FACE_MM - depth - 0.2 * size - size - bench.mouth_mm
    engage = recipe.tighten.engage
    told = (meets, engage.nut_from_mm, engage.nut_to_mm, rests, engage.edge_mm, engage.engaged_mm)
    rule = (meets, meets - 3.6, meets + 4.4, rests, rests + 1.5, rests + bench.hex_depth_mm + 1.0)
    assert told == pytest.approx(rule, abs=1e-6)
    text = (GUIDES / "process-engineer.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| [^|]+ \| ([\d.]+) \| ([\d.]+) \|$", text, re.MULTILINE)
    hand_started = length - depth - 0.2 * size - 2.0 * rotor.thread.pitch_mm
    assert [float(row[column]) for row in rows] == pytest.approx([*told, hand_started], abs=1e-6)
