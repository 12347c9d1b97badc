import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.records.canonical import canonical, number_of, plain_of


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    name: str
    values: np.ndarray


@dataclass(frozen=True)
class Outer:
    inner: Inner
    where: Path
    colour: Colour
    nothing: None = None


def test_keys_are_sorted_and_nothing_is_wasted() -> None:
    assert canonical({"b": 1, "a": [1.5, True, None]}) == '{"a":[1.5,true,null],"b":1}'
    assert canonical(MappingProxyType({2: "x"})) == '{"2":"x"}'


def test_dataclasses_arrays_enums_and_paths() -> None:
    value = Outer(Inner("n", np.array([[1, 2], [3, 4]])), Path("/home/someone/cell.toml"), Colour.RED)
    assert json.loads(canonical(value)) == {
        "inner": {"name": "n", "values": [[1, 2], [3, 4]]},
        "where": "cell.toml",
        "colour": "red",
        "nothing": None,
    }


def test_numbers_that_json_lacks_are_text_and_come_back() -> None:
    text = canonical([math.nan, math.inf, -math.inf, np.float64("nan"), np.float32(0.5), np.int64(3), np.bool_(True)])
    assert text == '["NaN","Infinity","-Infinity","NaN",0.5,3,true]'
    values = [number_of(item) for item in json.loads(text)]
    assert math.isnan(values[0])
    assert values[1:3] == [math.inf, -math.inf]
    assert math.isnan(number_of(True))


def test_times_are_rfc3339() -> None:
    assert canonical(datetime(2000, 1, 1, tzinfo=UTC)) == '"2000-01-01T00:00:00.000000Z"'


@pytest.mark.parametrize("value", [{1, 2}, b"bytes", object(), {("a", "b"): 1}, {True: 1}])
def test_what_has_no_canonical_form_is_refused(value: object) -> None:
    with pytest.raises(TypeError):
        canonical(value)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=20,
    ).filter(lambda value: "\ud800" not in repr(value))
)
def test_reading_back_and_writing_again_gives_the_same_text(value: object) -> None:
    text = canonical(value)
    assert canonical(json.loads(text)) == text


def test_arrays_can_be_put_aside_by_name() -> None:
    seen: list[str] = []

    def aside(name: str, array: np.ndarray) -> str:
        seen.append(name)
        return f"<{array.size}>"

    value = {"value": Inner("n", np.zeros(7))}
    assert plain_of(value, aside) == {"value": {"name": "n", "values": "<7>"}}
    assert seen == ["values"]
