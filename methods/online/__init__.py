"""Methods that follow parameters while the samples arrive."""
