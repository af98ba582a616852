"""What every test shares: hypothesis draws the same examples everywhere, without a deadline."""

import os

from hypothesis import settings

# Kernels that run as plain Python take a hundred times longer.
few = os.environ.get("NUMBA_DISABLE_JIT") == "1"
settings.register_profile("rtin", deadline=None, derandomize=True, max_examples=20 if few else 60)
settings.load_profile("rtin")
