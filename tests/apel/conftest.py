"""Property tests without deadlines: the first call of a compiled function takes as long as its compilation."""

from hypothesis import settings

settings.register_profile("apel", deadline=None)
settings.load_profile("apel")
