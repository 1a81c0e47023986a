from .assembly import (
    assemble_mesh as assemble_mesh,
)
from .assembly import (
    build_fe_model as build_fe_model,
)
from .assembly import (
    replace_materials as replace_materials,
)
from .condensation import (
    Condensation as Condensation,
)
from .condensation import (
    condense as condense,
)
from .fe_model import (
    Coupling as Coupling,
)
from .fe_model import (
    FEModel as FEModel,
)
from .fe_model import (
    make_coupling as make_coupling,
)
from .full_model import (
    HarmonicSolution as HarmonicSolution,
)
from .full_model import (
    full_eigenfrequencies as full_eigenfrequencies,
)
from .full_model import (
    full_frequency_response as full_frequency_response,
)
from .materials import (
    Material as Material,
)
from .meshing import (
    generate_mesh as generate_mesh,
)
from .reduction import (
    craig_bampton as craig_bampton,
)
from .solid import (
    NearestTo as NearestTo,
)
from .solid import (
    OnPlane as OnPlane,
)
from .solid import (
    Solid as Solid,
)
from .solid import (
    body_names as body_names,
)
from .solid import (
    face_names as face_names,
)
from .solid import (
    glue as glue,
)
from .solid import (
    read_solid as read_solid,
)
from .solid import (
    shape_bytes as shape_bytes,
)
from .solver import (
    solver_name as solver_name,
)
from .solver import (
    threads as threads,
)
from .tessellation import (
    solid_surface as solid_surface,
)
