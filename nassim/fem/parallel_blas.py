"""Functions of SciPy's BLAS and LAPACK that several threads of Python can run at once.

SciPy's own wrappers hold the lock of the interpreter, so that only one thread computes. Here the same functions are
called by ctypes, which releases it. SciPy offers their addresses to compiled code.

All arrays are contiguous and in C's order. To BLAS, their rows are columns.
"""

import ctypes
from collections.abc import Callable
from ctypes import byref
from typing import Any

from scipy.linalg import cython_blas, cython_lapack

from nassim.base.checks import Array

_get_name = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)(("PyCapsule_GetName", ctypes.pythonapi))
_get_address = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


def _function(module: Any, name: str) -> Callable[..., None]:
    """Return a function of SciPy's BLAS or LAPACK, all of whose arguments are addresses."""
    capsule = module.__pyx_capi__[name]
    signature = _get_name(capsule)
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * (signature.count(b",") + 1))
    return kind(_get_address(capsule, signature))


_dpotrf = _function(cython_lapack, "dpotrf")
_dtrsm, _dsyrk = (_function(cython_blas, name) for name in ("dtrsm", "dsyrk"))
_ONE, _MINUS_ONE = byref(ctypes.c_double(1.0)), byref(ctypes.c_double(-1.0))


def _size(size: int) -> Any:
    """Return the address of a whole number."""
    return byref(ctypes.c_int(size))


def _entries(array: Array) -> Any:
    """Return the address of the entries of an array, in a third of the time of `array.ctypes`."""
    return byref(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]


def factorize_in_place(matrix: Array) -> bool:
    """Replace the upper triangle of a symmetric matrix (k, k) by R, where R^T R is the matrix.

    Returns:
        Whether the matrix is positive definite.
    """
    k, info = _size(len(matrix)), ctypes.c_int(0)
    _dpotrf(b"L", k, _entries(matrix), k, byref(info))
    return info.value == 0


def solve_in_place(upper: Array, rows: Array, *, transposed: bool) -> None:
    """Replace right-hand sides X by the solutions Y of R Y = X, or of R^T Y = X.

    Args:
        upper: upper triangle R, shape (k, k)
        rows: right-hand sides X, shape (k, m)
        transposed: whether it is R^T
    """
    k, m = _size(rows.shape[0]), _size(rows.shape[1])
    way = b"T" if transposed else b"N"
    _dtrsm(b"R", b"L", way, b"N", m, k, _ONE, _entries(upper), k, _entries(rows), m)


def subtract_products(rows: Array, matrix: Array) -> None:
    """Subtract X^T X from the upper triangle of a matrix (m, m); rows: X, shape (k, m)."""
    k, m = _size(rows.shape[0]), _size(rows.shape[1])
    _dsyrk(b"L", b"N", m, k, _MINUS_ONE, _entries(rows), m, _ONE, _entries(matrix), m)
