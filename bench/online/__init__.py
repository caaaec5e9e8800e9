"""The online track: scenarios with time-varying parameters, the posterior Cramér-Rao bound, and scores of trackers."""
