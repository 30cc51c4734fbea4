"""The balls a trajectory goes through piece by piece, and first polylines in them.

Along one station sequence: `corridor` says which balls hold each piece, `chebyshev` where its joints always fit,
`limit_check` whether control points keep it. Polylines are the shortest by a cone program (`polyline_program`, solved
by `cone_program`) or the fastest expected with handovers priced (`handover_polyline`, on the `funnel` algorithm), and
`joint_placement` puts the joints on them. Alternating minimisation and the joint program both begin here.
"""

from planner.corridor.corridor import build_corridor
from planner.corridor.polyline_program import polyline_length_m, shortest_polyline

__all__ = ["build_corridor", "polyline_length_m", "shortest_polyline"]
