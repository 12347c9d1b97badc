"""`cellctl validate`: every fault of recipes, cell, calibration and fault files with its place. Exit 0 or 2."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellctl.calibration import Calibration
from cellctl.checks.finding import Finding
from cellctl.file_faults import parsed, read_toml
from cellctl.recipe import parse_recipe, recipe_faults, recipe_schema
from cellctl.recipe_checks import check
from hal.config import CellConfig
from hal.errors import ConfigError

KEYS = {
    "recipe": ("recipe", "pattern"),
    "faults": ("fault", "expect"),
    "cell": ("devices", "cell"),
    "calibration": ("views", "table_axis", "artefact", "valid_from"),
}
"""What a file of each kind has at its top: any of these tells the kind."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault; `check` is the name of a physics check that may be forced, empty for anything else."""

    place: str
    reason: str
    limit: str = ""
    unit: str = ""
    check: str = ""

    def __str__(self) -> str:
        limit = f" (limit {self.limit}{' ' + self.unit if self.unit else ''})" if self.limit else ""
        return f"{self.place}: {self.reason}{limit}" + (f" [{self.check}]" if self.check else "")


@dataclass(frozen=True, slots=True)
class Checked:
    """One file: what it was taken for and what is wrong with it."""

    file: str
    kind: str
    faults: tuple[Fault, ...]


@dataclass(frozen=True, slots=True)
class Bench:
    """The cell that recipes are checked against, where one was given."""

    cell: CellConfig | None = None
    calibration: Calibration | None = None


def add_parser(subparsers: Any) -> None:
    """Add `validate` to the commands."""
    parser = subparsers.add_parser("validate", help="every fault of recipes, cell, calibration and fault files")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="TOML files")
    parser.add_argument("--cell", type=Path, help="also check recipes against this cell and its calibration")
    parser.add_argument("--schema", action="store_true", help="print the JSON schema of a recipe instead")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Check and print. Returns 0 where nothing is wrong, otherwise 2."""
    if args.schema:
        print(recipe_schema(), end="")
        return 0
    checked = [] if args.cell is None else [validate(args.cell)]
    bench = bench_of(args.cell) if args.cell is not None and not checked[0].faults else Bench()
    checked += [validate(path, bench) for path in args.files]
    if not checked:
        checked = [Checked("", "unknown", (Fault("FILE", "no file was given"),))]
    valid = not any(one.faults for one in checked)
    if args.json:
        print(json.dumps({"valid": valid, "files": [as_document(one) for one in checked]}))
    else:
        for one in checked:
            print(f"{one.file}: {one.kind}, {f'{len(one.faults)} faults' if one.faults else 'valid'}")
            for fault in one.faults:
                print(f"  {fault}")
    return 0 if valid else 2


def validate(path: Path, bench: Bench | None = None) -> Checked:
    """Everything that is wrong with one file. Never raises for what the file holds."""
    try:
        text = path.read_text(encoding="utf-8")
        data = read_toml(text, path.name)
    except (OSError, UnicodeDecodeError) as error:
        return Checked(str(path), "unknown", (Fault(path.name, f"cannot be read: {error}"),))
    except ConfigError as error:
        return Checked(str(path), "unknown", (_fault(error),))
    kind = kind_of(data)
    if kind == "recipe":
        return Checked(str(path), kind, tuple(_recipe(text, path.name, bench or Bench())))
    errors = _errors(kind, data, text, path)
    return Checked(str(path), kind, tuple(_fault(error) for error in errors))


def kind_of(data: dict[str, Any]) -> str:
    """Which kind of file has such keys at its top."""
    return next((kind for kind, keys in KEYS.items() if any(key in data for key in keys)), "unknown")


def bench_of(path: Path) -> Bench:
    """Cell and calibration of a cell file that was found valid."""
    from cellctl.calibration import load_calibration
    from hal.config import load_cell

    cell = load_cell(path)
    return Bench(cell, load_calibration(cell.calibration_path))


def as_document(one: Checked) -> dict[str, Any]:
    """One file in terms of JSON."""
    faults = [{name: getattr(fault, name) for name in Fault.__slots__} for fault in one.faults]
    return {"file": one.file, "kind": one.kind, "faults": faults}


def _recipe(text: str, source: str, bench: Bench) -> list[Fault]:
    errors = recipe_faults(text, source=source)
    if errors:
        return [_fault(error) for error in errors]
    findings = check(parse_recipe(text, source=source), bench.cell, bench.calibration)
    return [_finding(finding, source) for finding in findings]


def _errors(kind: str, data: dict[str, Any], text: str, path: Path) -> list[ConfigError]:
    if kind == "faults":
        from hal.fake.fault_file import wrong_places

        return list(wrong_places(text, source=path.name))
    if kind == "calibration":
        return parsed(Calibration, data, path.name)[1]
    if kind == "cell":
        return _cell(data, path)
    limit = ", ".join(KEYS)
    return [ConfigError("neither recipe, cell, calibration nor fault file", place=path.name, limit=limit)]


def _cell(data: dict[str, Any], path: Path) -> list[ConfigError]:
    cell, errors = parsed(CellConfig, data | {"path": path}, path.name)
    if cell is None:
        return errors
    place = f"{path.name}.calibration.file"
    inner = validate(cell.calibration_path)
    if inner.kind != "calibration":
        errors.append(ConfigError(f"{cell.calibration.file} is no calibration", place=place))
    errors += [
        ConfigError(fault.reason, place=fault.place, limit=fault.limit, unit=fault.unit) for fault in inner.faults
    ]
    return errors + _overrides(cell, path.name)


def _overrides(cell: CellConfig, source: str) -> list[ConfigError]:
    """Names that the twin does not know, each for itself."""
    from hal.fake.levels import numbers

    errors = []
    for name, value in cell.twin.overrides.items():
        try:
            numbers(cell.twin.level, {name: value})
        except ConfigError as error:
            place = f"{source}.twin.overrides.{name}"
            errors.append(ConfigError(error.reason, place=place, limit=error.limit, unit=error.unit))
    return errors


def _fault(error: ConfigError) -> Fault:
    return Fault(error.place, plain_reason(error), error.limit, error.unit)


def _finding(finding: Finding, source: str) -> Fault:
    return Fault(f"{source}.{finding.place}", finding.reason, finding.limit, finding.unit, finding.name)


def plain_reason(error: ConfigError) -> str:
    """The reason of an error without the place and limit that its text carries as well."""
    text = error.reason.removeprefix(f"{error.place}: ")
    tail = f" (limit {error.limit}{' ' + error.unit if error.unit else ''})"
    return text.removesuffix(tail) if error.limit else text
