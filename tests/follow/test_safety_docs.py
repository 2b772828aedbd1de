"""The pages made from the gate's code say what the code says."""

import pytest

from tools.docs import safety
from tools.docs.safety import DOCS


@pytest.mark.parametrize("page", safety.PAGES)
def test_the_page_says_what_the_code_says(page):
    assert (DOCS / page).read_text() == safety.PAGES[page](), "run: python -m tools.docs.safety"


def test_every_limit_and_mode_gives_its_reason():
    for page in safety.PAGES.values():
        assert "|  |" not in page()
