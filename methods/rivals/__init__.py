"""Inverse PINNs of other people's packages, as they ship: their networks, losses and optimisers, one package a file."""
