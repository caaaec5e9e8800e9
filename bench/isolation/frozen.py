"""Preloaded last by the server of all processes.

The server adopts what its children leave behind, and keeps the collector off what they share, which would copy it.
"""

import gc
import warnings

from bench.isolation.descendants import adopt

adopt()
warnings.filterwarnings("ignore", message="forkserver: waitpid returned")  # of what was adopted, once it has ended
gc.collect()
gc.freeze()
