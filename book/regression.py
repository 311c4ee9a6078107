"""Logistic regression with an offset, as chapter 3's discriminator is."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import expit


def exact_loss(
    logit: Float[Array, "N"],
    ones: Float[Array, "N"],
    zeros: Float[Array, "N"],
) -> float:
    """Return the cross-entropy of labels with so much weight each."""
    return ones @ np.logaddexp(0, -logit) + zeros @ np.logaddexp(0, logit)


def regress(
    x: Float[Array, "N K"],
    log_pi: Float[Array, "N"],
    ones: Float[Array, "N"],
    zeros: Float[Array, "N"],
    w: Float[Array, "K"] | None = None,
) -> Float[Array, "K"]:
    """Return w of least cross-entropy of the logit x @ w - log π.

    Newton's method, damped as Levenberg and Marquardt do.
    """
    w = np.zeros(x.shape[1]) if w is None else w
    best, damping = exact_loss(x @ w - log_pi, ones, zeros), 1.0
    for _ in range(200):
        d, not_d = expit(x @ w - log_pi), expit(log_pi - x @ w)
        hessian = x.T @ (((ones + zeros) * d * not_d)[:, None] * x)
        hessian += damping * np.eye(len(w))
        step = np.linalg.solve(hessian, x.T @ (ones * not_d - zeros * d))
        loss = exact_loss(x @ (w + step) - log_pi, ones, zeros)
        if loss <= best:
            w, best, damping = w + step, loss, max(damping / 10, 1e-13)
        else:
            damping *= 10
        if np.abs(x @ step).max() < 1e-11:
            break
    return w
