"""Preloaded last by the server of all processes, which adopts what its children leave behind.

The collector is kept off what they share, which would copy it. The server leaves the group of its parent, so that a
child that stops the group of the server does not stop the run.
"""

import gc
import os
import warnings

from bench.isolation.descendants import adopt

adopt()
if os.getpgrp() != os.getpid():
    os.setsid()
warnings.filterwarnings("ignore", message="forkserver: waitpid returned")  # of what was adopted, once it has ended
gc.collect()
gc.freeze()
