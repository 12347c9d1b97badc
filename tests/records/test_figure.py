import math
import re
from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from cellctl.records.figure import MOST_POINTS, Line, chart, thinned, ticks


def test_a_chart_is_well_formed_and_escapes_its_labels() -> None:
    svg = chart(
        [Line("a<b>", [0.0, 1.0], [1.0, math.nan]), Line("c", [0.0], [5.0])], x_label="<s>", y_label="N", limit=10
    )
    root = ElementTree.fromstring(svg)
    assert root.tag == "svg"
    assert len(re.findall("<polyline", svg)) == 2
    assert "limit 10" in svg


def test_nothing_to_draw_is_no_chart() -> None:
    assert chart([Line("a", [math.nan], [1.0])], x_label="", y_label="") == ""


def test_thinning_keeps_every_peak() -> None:
    y = [0.0] * 100_000
    y[54_321] = 9.5
    points = thinned(Line("a", list(range(len(y))), y))
    assert len(points) <= MOST_POINTS
    assert (54_321.0, 9.5) in points
    assert points == sorted(points)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_are_few_and_inside(low: float, width: float) -> None:
    values = ticks(low, low + width)
    assert 1 <= len(values) <= 7
    assert all(low - 1e-6 * width <= value <= low + width * (1 + 1e-6) for value in values)
