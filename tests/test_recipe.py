import random
from pathlib import Path

import pytest

from cellctl.recipe import Recipe, load_recipe, parse_recipe, recipe_faults, recipe_schema
from hal.errors import ConfigError

ROOT = Path(__file__).parents[1]
RECIPES = sorted((ROOT / "recipes").glob("*.toml"))
LPT = (ROOT / "tests" / "checks" / "joint_36.toml").read_text()


def lpt(*changes: tuple[str, str]) -> str:
    text = LPT
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new, 1)
    return text


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_every_recipe_of_the_house_is_valid_and_named_as_its_file(path: Path) -> None:
    assert recipe_faults(path.read_text()) == []
    assert load_recipe(path).recipe.id == path.stem


def test_the_schema_is_current_and_carries_units() -> None:
    text = (ROOT / "recipes" / "recipe.schema.json").read_text()
    assert text == recipe_schema(), "run: cellctl validate --schema > recipes/recipe.schema.json"
    assert '"unit": "N.m"' in text


def test_every_fault_is_told_with_place_limit_and_unit() -> None:
    text = lpt(
        ("count = 36", "count = 2"),
        ("soak_s = 60.0", "soak_s = -1.0"),
        ("torque_nm = 18.0", 'torque_nm = "18"'),
        ("gap_mm = 0.05", "gap_mm = nan\nbeside = 1"),
        ("diameter_mm = 8.3", "diameter_mm = [8.3, -1.0]"),
    )
    faults = {fault.place: (fault.limit, fault.unit) for fault in recipe_faults(text, source="r.toml")}
    assert faults == {
        "r.toml.pattern.count": (">= 3", ""),
        "r.toml.shaft.diameter_mm.1": ("> 0.0", "mm"),
        "r.toml.heat.soak_s": (">= 0.0", "s"),
        "r.toml.tighten.stages.1.torque_nm": ("", "N.m"),
        "r.toml.limits.gap_mm": ("", "mm"),
        "r.toml.limits.beside": ("", ""),
    }
    with pytest.raises(ConfigError, match=r"r\.toml\.pattern\.count"):
        parse_recipe(text, source="r.toml")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('angles_deg = "equal"', "angles_deg = [0.0, 120.0, 240.0]"), "3 entries"),
        (('angles_deg = "equal"', "index_feature = 36"), "below 36"),
        (("diameter_mm = 8.3", "diameter_mm = [8.3, 8.3]"), "2 entries"),
        (("max_retakes = 2", "max_retakes = true"), "integer"),
        (("max_retakes = 2", "max_retakes = 2.0"), "integer"),
        (("gate_xy_mm = 0.04", "gate_xy_mm = true"), "number"),
        (("gate_xy_mm = 0.04", "gate_xy_mm = inf"), "finite"),
        (('id = "lpt_shaft_36"', 'id = "../../etc"'), "pattern"),
        (("version = 1", "version = 1\nversion = 2"), "TOML"),
    ],
)
def test_wrong_recipes_are_refused(change: tuple[str, str], said: str) -> None:
    faults = recipe_faults(lpt(change))
    assert len(faults) == 1
    assert said in faults[0].reason
    with pytest.raises(ConfigError):
        parse_recipe(lpt(change))


def test_a_recipe_that_only_measures_needs_one_part() -> None:
    head = '[recipe]\nid = "a"\nversion = 1\ntitle = "t"\n[pattern]\ncount = 5\ncircle_diameter_mm = 50.0\n'
    recipe = parse_recipe(head + '[shaft]\nfeature = "hole"\ndiameter_mm = 6\n')
    assert recipe.part("shaft").diameter_mm == (6.0,) * 5
    with pytest.raises(ConfigError, match="no such part"):
        recipe.part("rotor")
    assert "one of" in recipe_faults(head)[0].reason


def test_the_rotors_angles_are_mirrored() -> None:
    recipe = load_recipe(ROOT / "recipes" / "compressor_drum_24.toml")
    shaft, rotor = recipe.part("shaft"), recipe.part("rotor")
    assert shaft.angles_deg[1] == 14.0
    assert rotor.angles_deg == tuple(-angle for angle in shaft.angles_deg)


def test_the_content_hash_is_of_the_numbers_and_not_of_the_text() -> None:
    recipe = parse_recipe(LPT)
    assert parse_recipe(LPT + "\n# a remark\n").content_hash == recipe.content_hash
    assert parse_recipe(lpt(("soak_s = 60.0", "soak_s = 60"))).content_hash == recipe.content_hash
    assert parse_recipe(lpt(("soak_s = 60.0", "soak_s = 61.0"))).content_hash != recipe.content_hash


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "r.toml", tmp_path / "none.toml", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            load_recipe(path)


def test_mutated_files_are_taken_or_refused_but_never_crash() -> None:
    chance = random.Random(11)
    pieces = ["nan", "inf", "-1", "[", "]", "=", '"', "true", "1e308", "[[", "[x]", "\n", "9" * 400, "", "[" * 300]
    taken = 0
    for _ in range(300):
        text = LPT
        for _ in range(chance.randrange(1, 4)):
            place = chance.randrange(len(text))
            text = text[:place] + chance.choice(pieces) + text[place + chance.randrange(12) :]
        faults = recipe_faults(text)
        if not faults:
            taken += 1
            recipe = parse_recipe(text)
            assert isinstance(recipe, Recipe)
            assert Recipe.model_validate_json(recipe.model_dump_json()) == recipe
    assert taken < 200
