"""A trained network as arrays that can be stored, and back."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import numpy as np
import torch

from methods.amortised.cache import Arrays
from methods.amortised.density import Density, trained
from methods.amortised.simulations import SampleLayout

SECONDS = "training_seconds"


def definition() -> str:
    """What decides a network beside its settings: a digest of the source of the simulations and of the training."""
    folder = Path(__file__).parent
    texts = [(folder / name).read_bytes() for name in ("simulations.py", "density.py")]
    return hashlib.sha256(b"".join(texts)).hexdigest()


def as_arrays(layout: SampleLayout, settings: dict[str, int], rate: float) -> Arrays:
    """Train a network; its weights by name, and the processor time (s) that it took."""
    before = time.process_time()
    network = trained(layout, settings, rate)
    arrays = {name: value.numpy() for name, value in network.state_dict().items()}
    return {**arrays, SECONDS: np.array(time.process_time() - before)}


def network_from(arrays: Arrays, settings: dict[str, int]) -> tuple[Density, float]:
    """The network of stored arrays, and what its training took."""
    weights = {name: torch.as_tensor(value) for name, value in arrays.items() if name != SECONDS}
    inputs = int(weights["mean"].shape[0])
    network = Density(inputs, settings["width"], settings["depth"], settings["components"])
    network.load_state_dict(weights)
    return network.eval(), float(arrays[SECONDS])
