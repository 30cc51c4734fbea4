"""The plan: curve, handover schedule, contingencies, its document."""
