"""The parameters of a study's runs, as plans give them and sweeps take them."""

import keyword
from collections.abc import Iterator
from dataclasses import dataclass

from nassim.base.checks import Array, finite_array, freeze, known, unique


@dataclass(frozen=True)
class Samples:
    """Parameters of a study's runs, a row per run.

    names: of the parameters, as the function of the study spells its keywords
    values: shape (n_runs, n_parameters), in the parameters' own units
    plan: how they were chosen, for whoever reads the results

    Raises ValueError for no run, no parameter, NaN, a wrong shape and names that are no Python names.
    """

    names: tuple[str, ...]
    values: Array
    plan: str = ""

    def __post_init__(self) -> None:
        names = parameter_names(self.names)
        values = finite_array("values", self.values, (None, len(names)))
        if len(values) == 0:
            raise ValueError("samples hold no run; a study needs at least one row of values")
        freeze(self, names=names, values=values)

    def __len__(self) -> int:
        """Number of runs."""
        return len(self.values)

    def __getitem__(self, name: str) -> Array:
        """Values of one parameter, shape (n_runs,); raises ValueError for an unknown name."""
        column: Array = self.values[:, self.names.index(known("parameter", name, self.names))]
        return column

    def runs(self) -> Iterator[dict[str, float]]:
        """The parameters of each run by keyword, in order."""
        return (dict(zip(self.names, row, strict=True)) for row in self.values.tolist())


def parameter_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names that a function can have as keywords; raises ValueError for others, for none and for doubles."""
    result = unique("parameter", names)
    if not result:
        raise ValueError("a study needs at least one parameter, got none")
    wrong = [name for name in result if not name.isidentifier() or keyword.iskeyword(name)]
    if wrong:
        raise ValueError(f"parameters are given by keyword, so names must be Python's; these are not: {wrong}")
    return result
