"""Simulation of scenes: in time, at rest and in frequency.

Five sub-packages. `model` assembles the equations of small motion and holds what all engines share, `loaded` adds loads
and spin, `linear` makes linear models and exact steps, `exudyn` realises scenes as Exudyn systems (it is the only home
of Exudyn), and `run` chooses an engine, checks before a run and warns after it. `loaded` and `exudyn` import `model`
only, `linear` imports `loaded` and `model`, and `run` imports all.

To add an engine, realise the terms of `nassim.scene.terms` in a sub-package of its own. Checks before a run are in
`run.checks`, warnings after it in `run.warnings_of_runs`, the exceptions of a run in `model.stopped_runs`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
