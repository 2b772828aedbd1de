import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from racf import Box

sides = st.floats(0.5, 500)
places = st.floats(-1000, 1000)
boxes = st.builds(Box, places, places, sides, sides)


@given(boxes)
def test_a_box_written_and_read_is_the_same_box(box):
    assert Box.parse(f"{box.x!r},{box.y!r},{box.w!r},{box.h!r}") == box


@given(boxes, boxes)
def test_overlap_is_symmetric_and_between_0_and_1(a, b):
    assert a.iou(b) == pytest.approx(b.iou(a))
    assert 0 <= a.iou(b) <= 1 + 1e-9


@given(boxes, st.floats(0.1, 10))
def test_scaling_keeps_the_centre(box, factor):
    scaled = box.scaled(factor)
    assert scaled.centre_x == pytest.approx(box.centre_x, abs=1e-6)
    assert scaled.area == pytest.approx(box.area * factor**2)


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,4,5", "a,b,c,d", "1,2,0,4", "1,2,3,-4", "nan,1,2,3"])
def test_a_bad_box_is_refused_in_one_sentence(text):
    with pytest.raises(ValueError, match="a box") as caught:
        Box.parse(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.float32, np.float64, int])
def test_any_kind_of_number_makes_a_box_of_floats(kind):
    box = Box(*map(kind, (200, 100, 40, 30)))
    assert [type(v) for v in (box.x, box.y, box.w, box.h)] == [float] * 4
    assert box == Box(200.0, 100.0, 40.0, 30.0)
    assert box.area == 1200
    assert box.intersection(Box(0, 0, 1280, 720)) == 1200


@pytest.mark.parametrize("thing", [None, "wide", 1j, [1, 2], 10**400], ids=["None", "word", "complex", "list", "huge"])
def test_what_is_no_number_is_refused_in_one_sentence(thing):
    with pytest.raises(ValueError, match="a box needs four finite numbers, not 1,2,"):
        Box(1, 2, thing, 4)
