from .forms import (
    block as block,
)
from .forms import (
    cylinder as cylinder,
)
from .page import (
    write_page as write_page,
)
from .picture import (
    save_picture as save_picture,
)
from .subjects import (
    view_body as view_body,
)
from .subjects import (
    view_mesh as view_mesh,
)
from .subjects import (
    view_modes as view_modes,
)
from .subjects import (
    view_motion as view_motion,
)
from .subjects import (
    view_scene as view_scene,
)
from .subjects import (
    view_scene_modes as view_scene_modes,
)
from .subjects import (
    view_solid as view_solid,
)
from .views import (
    Form as Form,
)
from .views import (
    Mark as Mark,
)
from .views import (
    Mode as Mode,
)
from .views import (
    Shape as Shape,
)
from .views import (
    View as View,
)
