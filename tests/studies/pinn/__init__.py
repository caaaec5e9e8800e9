"""Cost and reliability of the PINN engine: ``python -m tests.studies.pinn``."""
