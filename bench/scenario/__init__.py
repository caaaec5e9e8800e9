"""Scenarios: which system, under which force, disturbed how, told what; and the truth that no method sees."""
