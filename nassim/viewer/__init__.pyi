from .forms import (
    block as block,
    cylinder as cylinder,
)
from .page import (
    write_page as write_page,
)
from .picture import (
    save_picture as save_picture,
)
from .stress_views import (
    view_stress as view_stress,
    view_stress_motion as view_stress_motion,
)
from .view_content import (
    Coloring as Coloring,
    Form as Form,
    Mark as Mark,
    Mode as Mode,
    Shape as Shape,
    View as View,
)
from .views import (
    view_body as view_body,
    view_buckling as view_buckling,
    view_faces as view_faces,
    view_mesh as view_mesh,
    view_modes as view_modes,
    view_motion as view_motion,
    view_scene as view_scene,
    view_scene_modes as view_scene_modes,
    view_solid as view_solid,
)
