"""Views, scenes and bodies in notebooks."""

import html

from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.scene import Scene
from nassim.viewer.page import page_text
from nassim.viewer.view_content import View
from nassim.viewer.views import view_body, view_scene

HEIGHT = 480
"""Height of a page in a notebook [px]."""
FIRST = 6
"""Number of eigenfrequencies on a body's card."""


def view_html(view: View) -> str:
    """Return a view as a page in a frame.

    Args:
        view: the view.
    """
    page = html.escape(page_text(view))
    return f'<iframe srcdoc="{page}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'


def scene_html(scene: Scene) -> str:
    """Return a scene as a page in a frame.

    Args:
        scene: the scene.
    """
    return view_html(view_scene(scene))


def body_html(body: ReducedBody) -> str:
    """Return a body as a page above a table of its points, frequencies and record.

    Args:
        body: the body.
    """
    frequency = body.eigenfrequencies(n=6 + FIRST)[6:]
    rows = {
        "remote points": ", ".join(body.point_names),
        "coordinates": str(len(body.mass_matrix)),
        "mass [kg]": f"{body.gram[0, 0]:.4g}",
        "first elastic frequencies, free [Hz]": ", ".join(f"{f:.5g}" for f in frequency),
        **body.record,
    }
    style = "text-align: left; vertical-align: top"
    lines = "".join(
        f'<tr><th style="{style}">{html.escape(name)}</th><td style="{style}">{html.escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f"{view_html(view_body(body))}<table><caption>{html.escape(body.name)}</caption>{lines}</table>"
