"""From a plan to stored results: the pool of tasks, cells with the two processes of a fit, launchers, progress."""
