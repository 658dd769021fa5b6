//! Symbolic planning over the world graph: the oracle's plan and the planner's.
