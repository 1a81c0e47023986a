"""Functions of tiny studies, in a module that every process can import."""

import os
import time

import numpy as np

from nassim import FRF, TimeHistory


def product(a, b=1.0):
    return a * b


def everything(a, gain=2.0):
    frequency = np.array([1.0, 2.0, 5.0])
    response = gain / (a - frequency**2 + 0.1j)
    return {
        "root": np.sqrt(a),
        "powers": np.array([[a, a**2], [a**3, a**4]]),
        "frf": FRF(frequency, response[None, None], ("encoder",), ("force",), np.full((1, 3), 0.5)),
        "history": TimeHistory([0.0, 0.1, 0.2], [[a, 0.0, 1.0], [0.0, a, 2.0]], ("u", "y"), ("V", "m")),
    }


def noisy(a, seed):
    return a + np.random.default_rng(seed).normal()


def troublesome(n):
    """A tenth raises; one hangs, one returns other shapes, one NaN, one ends its process."""
    if n % 10 == 3:
        raise RuntimeError(f"run {n} does\nnot converge")
    if n == 4:
        time.sleep(1e3)
    if n == 5:
        return {"x": np.zeros(3)}
    if n == 6:
        return {"x": np.nan}
    if n == 7:
        os._exit(5)
    return {"x": float(n)}
