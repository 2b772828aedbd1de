"""Tests run one to a core: a library's own threads would only fight the neighbour's."""

from hypothesis import settings

from racf.threads import one_core

one_core()
settings.register_profile("laws", deadline=None)  # a law does not depend on how busy the machine is
settings.load_profile("laws")
