"""The seed paper's experiments: enumeration, rivals, the readable cvxpy reference."""
