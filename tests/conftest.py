"""What every test shares: hypothesis draws the same examples everywhere, without a deadline.

Ctrl-C is heard, by programs that tests start too, even where the tests run in the background.
"""

import os
import signal

from hypothesis import settings

# Kernels that run as plain Python take a hundred times longer.
few = os.environ.get("NUMBA_DISABLE_JIT") == "1"
settings.register_profile("rtin", deadline=None, derandomize=True, max_examples=20 if few else 60)
settings.load_profile("rtin")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
