"""The configuration: Hydra groups method, system, prior and experiment. It travels with the package."""
