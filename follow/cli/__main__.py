"""`python -m follow.cli`."""

import sys

from follow.cli.start import main

sys.exit(main())
