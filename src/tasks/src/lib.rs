//! REAL-Bench tasks, scenes, the object library and the task generator.
