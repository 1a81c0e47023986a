"""The devices of a clone's folder `models`, by the name that they have in a wheel: `nassim.devices.bench`.

A wheel holds that folder itself here, in place of this module. In a clone both names lead to the same modules.
"""

import importlib
import pkgutil
import sys

_folder = importlib.import_module("models")
for _module in pkgutil.walk_packages(_folder.__path__, "models."):
    sys.modules[__name__ + _module.name.removeprefix("models")] = importlib.import_module(_module.name)
sys.modules[__name__] = _folder
