"""Scenarios: which system, under which force, disturbed how, told what; and the truth that no method sees."""

from bench.scenario import model_error as model_error  # its kinds of disturbance are found where they are loaded
