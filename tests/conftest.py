"""What every test shares: hypothesis draws the same examples everywhere, without a deadline."""

from hypothesis import settings

settings.register_profile("rtin", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("rtin")
