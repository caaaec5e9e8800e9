"""What the PINN engine costs and how far it can be trusted: ``python -m tests.studies.pinn``."""
