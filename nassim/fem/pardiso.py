"""PARDISO, the sparse Cholesky factorisation of Intel's Math Kernel Library (`pip install mkl`).

The library is called directly. Its default settings refine every solution with the matrix, which takes four times as
long as the solution and removes nothing but rounding errors of a positive definite matrix.
Source: Intel oneMKL Developer Reference for C, chapter "oneMKL PARDISO", for the calls, phases and settings.
"""

import ctypes
import ctypes.util
import sys
import weakref
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array

POSITIVE_DEFINITE = 2
ANALYZE_AND_FACTORIZE, SOLVE, RELEASE = 12, 33, -1
ZERO_PIVOT, NO_MEMORY = -4, -2
"""Error codes for a matrix that is not positive definite and for too little memory."""


@cache
def library_path() -> str | None:
    """Return the path of MKL's library, or None if it is not installed."""
    try:
        files = metadata.files("mkl") or []
    except metadata.PackageNotFoundError:
        files = []
    paths = [Path(str(file.locate())) for file in files if "mkl_rt" in file.name and file.suffix != ".lib"]
    paths += sorted(Path(sys.prefix).glob("lib/libmkl_rt.so*")) + sorted(Path(sys.prefix).glob("Library/bin/mkl_rt*"))
    return next((str(path.resolve()) for path in paths if path.exists()), ctypes.util.find_library("mkl_rt"))


def is_installed() -> bool:
    """Return whether MKL is installed."""
    return library_path() is not None


@cache
def _library() -> Any:
    return ctypes.CDLL(str(library_path()))


class Factor:
    """Cholesky factor of a symmetric positive definite matrix."""

    def __init__(self, upper: sp.csr_matrix, *, n_threads: int) -> None:
        """Factorise a matrix.

        Args:
            upper: upper triangle with the diagonal and sorted indices, shape (n, n)
            n_threads: number of threads of the factorisation

        Raises:
            ArithmeticError: if the matrix is not positive definite
            MemoryError: if there is not enough memory
        """
        self._n = upper.shape[0]
        self._matrix = upper.data, upper.indptr.astype(np.int64), upper.indices.astype(np.int64)
        self._handle = np.zeros(64, dtype=np.int64)
        self._settings = np.zeros(64, dtype=np.int64)
        self._settings[0] = 1  # all settings are given here, none is a default
        self._settings[1] = 2  # nested dissection
        self._settings[34] = 1  # indices begin at 0
        nothing = np.zeros((self._n, 0))
        self._call(ANALYZE_AND_FACTORIZE, nothing, nothing, n_threads)
        release = weakref.finalize(self, _call, RELEASE, self._handle, self._settings, self._matrix, nothing, nothing)
        release.atexit = False

    def solve(self, columns: Array) -> Array:
        """Solve for right-hand sides, shape (n, k), on one thread; two would gain little and keep processors busy."""
        rhs = np.asfortranarray(columns)
        solution = np.zeros_like(rhs)
        self._call(SOLVE, rhs, solution, 1)
        return solution

    def _call(self, phase: int, rhs: Array, solution: Array, n_threads: int) -> None:
        before = _library().MKL_Set_Num_Threads_Local(n_threads)
        try:
            error = _call(phase, self._handle, self._settings, self._matrix, rhs, solution)
        finally:
            _library().MKL_Set_Num_Threads_Local(before)
        if error == ZERO_PIVOT:
            raise ArithmeticError("the matrix is not positive definite")
        if error == NO_MEMORY:
            raise MemoryError("PARDISO has not enough memory for the factorisation")
        if error:
            raise RuntimeError(f"PARDISO failed with error {error}")


def _call(phase: int, handle: Any, settings: Any, matrix: Any, rhs: Array, solution: Array) -> int:
    """Call PARDISO with 64-bit integers and return its error code."""

    def address(array: Any) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    def number(value: int) -> Any:
        return ctypes.byref(ctypes.c_int64(value))

    entries, row_starts, columns = matrix
    error = ctypes.c_int64(0)
    _library().pardiso_64(
        address(handle),
        number(1),
        number(1),
        number(POSITIVE_DEFINITE),
        number(phase),
        number(len(row_starts) - 1),
        address(entries),
        address(row_starts),
        address(columns),
        address(np.zeros(1, dtype=np.int64)),
        number(max(1, rhs.shape[1])),
        address(settings),
        number(0),
        address(rhs),
        address(solution),
        ctypes.byref(error),
    )
    return error.value
