"""What the nano-hexapod's plates and payload look like; its struts have surfaces or boxes of their own."""

from collections.abc import Mapping

from models.nano_hexapod import PLATE_HEIGHT, PLATE_RADIUS
from nassim import FlexibleBody, Scene
from nassim.bodies import Surface
from nassim.kinematics import StewartPlatform
from nassim.viewer import cylinder

BASE_HEIGHT = 7e-3
"""Of the base's disc, which with the plates' radius has its mass in steel [m]."""


def looks(scene: Scene, platform: StewartPlatform) -> Mapping[str, Surface]:
    """Discs for the rigid ones of a scene's plates, see `view_scene`."""
    rigid = {body.name: body for body in scene.bodies if not isinstance(body, FlexibleBody)}
    middles = {"base": BASE_HEIGHT / 2, "plate": platform.height - PLATE_HEIGHT / 2}
    heights = {"base": BASE_HEIGHT, "plate": PLATE_HEIGHT}
    return {
        name: cylinder(PLATE_RADIUS, heights[name], (0, 0, middle - rigid[name].position[2]), label=name)
        for name, middle in middles.items()
        if name in rigid
    }
