"""Trackers: methods that update their estimates with every sample."""
