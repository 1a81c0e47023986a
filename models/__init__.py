"""Solids and scenes of real devices, with all their numerical values.

`apa300ml` is the actuator by finite elements and `two_mass` its model with three springs. `bench` is its test bench,
and `bench_figures` computes characteristic values of benches. `strut` puts the actuator between flexible joints;
`nano_hexapod` stands on six struts, with the geometry of one of the published `hexapods`. `nass` is the end-station
below the hexapod, with control loops in `nass_loops`.
"""
