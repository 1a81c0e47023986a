"""Samples: the parameters of the runs of a study."""

import keyword
from collections.abc import Iterator

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.field_types import ArrayField, NameList, data_class
from nassim.base.short_repr import short_repr


@data_class
class Samples:
    """Parameters of the runs of a study, one row per run.

    Attributes:
        names: names of the parameters, which are keywords of the study's function.
        values: (n_runs, n_parameters), in the units of the parameters.
        plan: description of how the values were chosen.

    Raises:
        ValueError: for no run, no parameter, NaN, a wrong shape and names that are not valid in Python.
    """

    names: NameList
    values: ArrayField
    plan: str = ""
    __repr__ = short_repr

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
        """Return the values of one parameter, (n_runs,); raise ValueError for an unknown name."""
        return self.values[:, self.names.index(known("parameter", name, self.names))]

    def runs(self) -> Iterator[dict[str, float]]:
        """Yield the parameters of each run by keyword, in order."""
        return (dict(zip(self.names, row, strict=True)) for row in self.values.tolist())


def parameter_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names that are valid keywords of a function; raise ValueError for invalid, missing or repeated names.

    Args:
        names: names of parameters.
    """
    result = unique("parameter", names)
    if not result:
        raise ValueError("a study needs at least one parameter, got none")
    wrong = [name for name in result if not name.isidentifier() or keyword.iskeyword(name)]
    if wrong:
        raise ValueError(f"parameters are given by keyword, so names must be Python's; these are not: {wrong}")
    return result
