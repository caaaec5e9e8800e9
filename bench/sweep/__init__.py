"""From a plan to stored cells: launchers, queue, workers, and the two processes of a fit."""
