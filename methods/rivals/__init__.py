"""Methods of other packages for comparison: inverse PINNs with their networks, losses and optimisers, and EMA."""
