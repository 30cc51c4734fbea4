"""A mission laid out on its plane: from positions on the earth to the planner's problem."""
