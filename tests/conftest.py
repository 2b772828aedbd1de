"""Tests run one to a core: a library's own threads would only fight the neighbour's."""

from racf.threads import one_core

one_core()
