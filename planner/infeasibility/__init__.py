"""What makes a problem impossible, and the changes that would help.

`infeasibility_of` says why there is no plan, with remedies (`planner.remedy`): what is wrong with the ranges
(`diagnosis`) or a limit (`limit_faults`), and what else would help (`alternatives`). `remedied` carries a remedy out
(`application`).
"""

from planner.infeasibility.application import remedied
from planner.infeasibility.diagnosis import diagnose
from planner.infeasibility.explanation import diagnose_ranges, infeasibility_of

__all__ = ["diagnose", "diagnose_ranges", "infeasibility_of", "remedied"]
