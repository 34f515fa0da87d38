"""Settings of all tests."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # machines are shared: the first call of a kernel compiles it
settings.load_profile("untimed")
