"""The house: sizes of files and functions, and where things live."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
FILES = sorted(path for package in ("hal", "cellctl") for path in (ROOT / package).rglob("*.py"))


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_median_file_is_at_most_120_lines_and_none_is_over_400() -> None:
    sizes = {str(path.relative_to(ROOT)): lines(path) for path in FILES if path.name != "__init__.py"}
    assert median(sizes.values()) <= 120, sorted(sizes.items(), key=lambda item: -item[1])[:10]
    assert max(sizes.values()) <= 400, max(sizes.items(), key=lambda item: item[1])


def test_functions_are_short() -> None:
    long = [
        f"{path.relative_to(ROOT)}:{node.name} {node.end_lineno - node.lineno + 1}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno is not None
        and node.end_lineno - node.lineno + 1 > 60
    ]
    assert not long, long


def test_no_code_asks_whether_it_is_simulated() -> None:
    guilty = [
        str(path.relative_to(ROOT))
        for path in (ROOT / "cellctl").rglob("*.py")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.If) and "simulat" in ast.unparse(node.test)
    ]
    assert not guilty, guilty


def test_wire_libraries_have_one_importer_each() -> None:
    for library in ("can", "pymodbus", "serial", "harvesters"):
        importers = [
            str(path.relative_to(ROOT))
            for path in FILES
            for node in ast.walk(tree(path))
            if (isinstance(node, ast.Import) and any(name.name.split(".")[0] == library for name in node.names))
            or (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == library and not node.level)
        ]
        assert len(set(importers)) <= 1, (library, importers)
