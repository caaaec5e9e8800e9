"""Where a fit starts, from the data alone: scans for frequency and decay, equation error, what the data leave open."""
