"""Memory of this process."""

import importlib
import sys

import psutil


def peak_memory() -> float:
    """Return the largest memory that this process has used so far [bytes]."""
    info = psutil.Process().memory_info()
    if hasattr(info, "peak_wset"):  # Windows
        return float(info.peak_wset)
    resource = importlib.import_module("resource")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)
