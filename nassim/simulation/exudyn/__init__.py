"""Scenes as Exudyn systems. No other sub-package imports Exudyn.

`system` builds a system, `items` and `springs` add its items, `general_items` has an item for any law on any measure,
`running_system` keeps what a run needs of it, and `solver` integrates it. A scene in small motion has one modal object,
see `small_motion_system`. `outputs` and `spring_forces` record, `filtering` filters outputs, `frame_poses` reads poses,
`monitor` checks runs, `motion_recorder` records motion for pictures, and `steady_state` finds equilibria in steady
rotation and under weight. To realise a new term in large motion, see `system` and `items`.
"""
