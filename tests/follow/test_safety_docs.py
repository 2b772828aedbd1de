"""The pages generated from the gate's code agree with the code."""

import pytest

from tools.docs import safety, settings
from tools.docs.safety import DOCS

PAGES = {**safety.PAGES, **settings.PAGES}


@pytest.mark.parametrize("page", PAGES)
def test_the_page_says_what_the_code_says(page):
    assert (DOCS / page).read_text() == PAGES[page](), (
        "run: python -m tools.docs.safety and python -m tools.docs.settings"
    )


def test_every_limit_and_mode_gives_its_reason():
    for page in PAGES.values():
        assert "|  |" not in page()
