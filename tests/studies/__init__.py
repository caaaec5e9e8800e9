"""Long measurements, one command each, run from the repository: they see methods and truth alike; not installed."""
