"""Set up the server from which all child processes are forked; imported by the server, after all other modules.

The server adopts the orphans of its children, and has its own process group, so that a child that stops the server's
group does not stop the run. The garbage collector ignores the imported objects, since it would copy their shared
memory.
"""

import gc
import os
import warnings

from bench.isolation.descendants import adopt

adopt()
if os.getpgrp() != os.getpid():
    os.setsid()
warnings.filterwarnings("ignore", message="forkserver: waitpid returned")  # issued when an adopted process ends
gc.collect()
gc.freeze()
