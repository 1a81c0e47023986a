from .poses import (
    forward_kinematics as forward_kinematics,
)
from .poses import (
    inverse_kinematics as inverse_kinematics,
)
from .poses import (
    jacobian as jacobian,
)
from .poses import (
    joint_angles as joint_angles,
)
from .reach import (
    strut_strokes as strut_strokes,
)
from .reach import (
    workspace as workspace,
)
from .stewart import (
    StewartPlatform as StewartPlatform,
)
from .stewart import (
    strut_directions as strut_directions,
)
from .stewart import (
    strut_frames as strut_frames,
)
from .stewart import (
    strut_lengths as strut_lengths,
)
from .stewart import (
    strut_vectors as strut_vectors,
)
from .stiffness import (
    compliance_matrix as compliance_matrix,
)
from .stiffness import (
    stiffness_matrix as stiffness_matrix,
)
from .stiffness import (
    strut_forces as strut_forces,
)
