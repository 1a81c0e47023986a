"""The C compiler of this machine, and the libraries that it makes for FMUs."""

import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")
MACHINES = {"amd64": "x86_64", "x86_64": "x86_64", "x64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
FMI2_FOLDERS = {"x86_64-linux": "linux64", "x86_64-darwin": "darwin64", "x86_64-windows": "win64"}
TIME_LIMIT = 600.0
"""Longest time of a compilation [s]."""


def find_compiler() -> str:
    """Return the path of a C compiler.

    Raises:
        RuntimeError: if there is none.
    """
    for name in COMPILERS:
        if found := shutil.which(name):
            return found
    raise RuntimeError(
        f"no C compiler on this machine: looked for {', '.join(COMPILERS)}; install one, or give binaries=False for an "
        "FMU of sources alone, which the importing program must compile"
    )


def binary_of(version: str, identifier: str) -> str:
    """Return the place of this machine's library in an FMU, such as "binaries/x86_64-linux/model.so".

    Args:
        version: version of FMI.
        identifier: the model's identifier.

    Raises:
        RuntimeError: for a machine that this version of FMI has no name for.
    """
    system, ending = SYSTEMS.get(sys.platform, ("", ""))
    machine = MACHINES.get(platform.machine().lower(), "")
    folder = f"{machine}-{system}"
    if version == "2.0":
        folder = FMI2_FOLDERS.get(folder, "")
    if not system or not machine or not folder:
        raise RuntimeError(
            f"FMI {version} names no folder for binaries of {platform.machine()} under {sys.platform}: take another "
            "version, or give binaries=False"
        )
    return f"binaries/{folder}/{identifier}{ending}"


def compile_library(sources: Sequence[Path], library: Path, *, more: Sequence[str] = ()) -> None:
    """Compile C99 sources to a shared library.

    Args:
        sources: the source files; headers are found beside them.
        library: file that is written.
        more: more options of the compiler.

    Raises:
        RuntimeError: without a compiler, and when it fails.
    """
    compiler = find_compiler()
    command = [compiler, "-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", *more, "-o", str(library)]
    library.parent.mkdir(parents=True, exist_ok=True)
    try:
        run = subprocess.run(
            [*command, *map(str, sources)], capture_output=True, text=True, check=False, timeout=TIME_LIMIT
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RuntimeError(f"the C compiler {compiler} failed: {error}; give binaries=False") from error
    if run.returncode:
        raise RuntimeError(f"the C compiler {compiler} failed:\n{run.stderr.strip()[:2000]}\nor give binaries=False")
