"""The pages made from the gate's code say what the code says."""

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
spec = importlib.util.spec_from_file_location("draw_safety", DOCS / "draw_safety.py")
draw_safety = importlib.util.module_from_spec(spec)
spec.loader.exec_module(draw_safety)


@pytest.mark.parametrize("page", draw_safety.PAGES)
def test_the_page_says_what_the_code_says(page):
    assert (DOCS / page).read_text() == draw_safety.PAGES[page](), "run: python docs/draw_safety.py"


def test_every_limit_and_mode_gives_its_reason():
    for page in draw_safety.PAGES.values():
        assert "|  |" not in page()
