"""Scenarios: which system, under which force, disturbed how, what is known; and the truth that no method sees."""

from bench.scenario import model_error as model_error  # its kinds of disturbance are known once they are loaded
