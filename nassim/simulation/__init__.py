"""Engines: what a scene does in time, at rest and in frequency. Exudyn is used in `exudyn` and nowhere else.

`small_motion` puts bodies and words together; from there `linearization`, `exact_steps` and `exudyn` go their ways,
and `time_domain` chooses among them; `spinning` adds what a turning table does, `standing` what stands beside it
(`sides` tells who), `following` what drives do that follow inputs, `filters` what sensors let through. `compensation`
makes steps keep periods, of which `accuracy` tells what is left. `scene_body` makes one body of a scene. What digital
controllers do is in `running_loops`, one by one, and in `closed_steps`, all in one with the scene.

To add an engine, realise the words of `nassim.scene.part` in a room of its own; to add a check before or a warning
after a run, open `run_checks` and `guards`; `reach` bounds motion, `stopped_runs` has what a run raises.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
