"""Scenes: bodies and parts connected by name, as pure data; parts return their terms, which are laws on measures.

To add a kind of part (sensor, actuator, spring, joint), write one class with a method `terms`. `measures` has what can
be measured, `terms` the laws; `springs`, `forces`, `joints`, `drives`, `piezo`, `motion_sensors` and `instruments`
(sensors with dynamics) show how. `placement` puts scenes into scenes. Engines are in `nassim.simulation`; they need no
change.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
