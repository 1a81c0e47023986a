from .poses import (
    forward_kinematics as forward_kinematics,
    inverse_kinematics as inverse_kinematics,
    jacobian as jacobian,
    joint_angles as joint_angles,
)
from .stewart import (
    StewartPlatform as StewartPlatform,
    strut_directions as strut_directions,
    strut_frames as strut_frames,
    strut_lengths as strut_lengths,
    strut_vectors as strut_vectors,
)
from .stiffness import (
    compliance_matrix as compliance_matrix,
    stiffness_matrix as stiffness_matrix,
    strut_forces as strut_forces,
)
from .strokes import (
    strut_strokes as strut_strokes,
    workspace as workspace,
)
