from .accuracy import (
    build_fe_model as build_fe_model,
)
from .assembly import (
    assemble_mesh as assemble_mesh,
    replace_materials as replace_materials,
)
from .condensation import (
    Condensation as Condensation,
    condense as condense,
)
from .curving import (
    curve_mesh as curve_mesh,
    folded_elements as folded_elements,
)
from .face_picks import (
    Extreme as Extreme,
    NearestTo as NearestTo,
    OfColour as OfColour,
    OnBody as OnBody,
    OnCylinder as OnCylinder,
    OnPlane as OnPlane,
    name_faces as name_faces,
)
from .face_tables import (
    face_table as face_table,
)
from .faces import (
    Face as Face,
    list_faces as list_faces,
)
from .fe_model import (
    Coupling as Coupling,
    FEModel as FEModel,
    MeshRound as MeshRound,
    make_coupling as make_coupling,
)
from .full_model import (
    HarmonicSolution as HarmonicSolution,
    full_eigenfrequencies as full_eigenfrequencies,
    full_frequency_response as full_frequency_response,
)
from .materials import (
    Material as Material,
)
from .meshing import (
    generate_mesh as generate_mesh,
)
from .native_threads import (
    threads as threads,
)
from .reduction import (
    craig_bampton as craig_bampton,
)
from .solid import (
    Solid as Solid,
    body_names as body_names,
    face_names as face_names,
    glue as glue,
    read_solid as read_solid,
    shape_bytes as shape_bytes,
)
from .solver import (
    solver_name as solver_name,
)
from .stress_places import (
    GaugeLine as GaugeLine,
    StressPoint as StressPoint,
    StressSurface as StressSurface,
)
from .tessellation import (
    face_surface as face_surface,
    solid_surface as solid_surface,
)
