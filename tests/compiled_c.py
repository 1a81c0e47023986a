"""C code of `export_c`, compiled with all warnings as errors and run under sanitizers."""

import os
import shutil
import subprocess

import numpy as np

COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow", "-Wconversion")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
MAIN = """\
#include <stdio.h>
#include "{name}.h"

typedef char size_is_as_said[sizeof({name}_state) == {size} ? 1 : -1];

int main(void)
{{
    {name}_state state;
    {name}_real u[{NAME}_INPUTS], y[{NAME}_OUTPUTS];
    int first = 1;
    while (fread(u, sizeof *u, {NAME}_INPUTS, stdin) == {NAME}_INPUTS) {{
        if (first)
            {name}_init(&state, u);
        first = 0;
        {name}_output(&state, u, y);
        fwrite(y, sizeof *y, {NAME}_OUTPUTS, stdout);
        {name}_step(&state, u);
    }}
    return 0;
}}
"""


def run_c(code, inputs, kind=float):
    """Run written code with inputs, (inputs, n); return the outputs, (outputs, n)."""
    name, folder = code.header.stem, code.header.parent
    main, program = folder / f"main_{name}.c", folder / f"main_{name}"
    main.write_text(MAIN.format(name=name, NAME=name.upper(), size=code.state_bytes), encoding="utf-8")
    subprocess.run([COMPILER, *STRICT, *SANITIZED, "-o", program, main, code.source], check=True)
    given = np.ascontiguousarray(inputs.T, dtype=kind).tobytes()
    environment = os.environ | {"ASAN_OPTIONS": "detect_leaks=0"}
    run = subprocess.run([program], input=given, capture_output=True, check=True, env=environment)
    return np.frombuffer(run.stdout, dtype=kind).reshape(inputs.shape[1], -1).T


def largest_error(found, expected):
    """Return the largest error of any signal over the largest value of that signal."""
    return (np.abs(found - expected).max(axis=1) / np.abs(expected).max(axis=1)).max()
