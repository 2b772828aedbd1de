"""`python -m follow.cli`."""

import sys

from follow.cli.program import main

sys.exit(main())
