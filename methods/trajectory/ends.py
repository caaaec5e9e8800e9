"""What a search from several starts leaves: the objective that each reached, and whether the best is a minimum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import OutputError


def ends(
    model: OutputError,
    theta: np.ndarray,
    residuals: np.ndarray,
    slopes: np.ndarray,
    sigma: np.ndarray,
    objectives: Sequence[float],
) -> dict[str, np.ndarray]:
    """Traces of a fit that ended at ``theta``.

    Args:
        model: Of the problem.
        theta: The vector of unknowns.
        residuals: What the predictions there leave of the data, (N,).
        slopes: Derivatives (N, size) of the predictions there.
        sigma: Noise of each channel.
        objectives: Minus the log posterior, up to a constant, where the search from each start ended.

    Returns:
        ``start_objectives``, least first, and ``certificate``, ``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` of the standardised residuals
        with the Frobenius norm of J: the cosine between them, zero at a minimum.
    """
    weights = 1.0 / sigma[model.channel_of]
    rows, jacobian = -weights * residuals, weights[:, None] * slopes
    if model.prior is not None:
        rows = np.concatenate([rows, model.penalty(theta)])
        jacobian = np.concatenate([jacobian, np.eye(len(model.free), theta.size) / model.prior.log_sds[:, None]])
    lengths = float(np.linalg.norm(jacobian) * np.linalg.norm(rows))
    cosine = float(np.linalg.norm(jacobian.T @ rows)) / max(lengths, 1e-300)
    return {"start_objectives": np.sort(np.asarray(objectives, float)), "certificate": np.array([cosine])}
