/** The classes of failures: those of the rules, which a test of src/taxonomy compares. */
export const CLASSES: Record<string, string[]> = {
  "Object Confusion": ["wrong_instance", "wrong_kind", "wrong_attribute", "wrong_receptacle", "similar_furniture", "ignored_answer"],
  "Key Action Missing": ["missing_ask", "missing_open", "missing_pick", "missing_place", "never_looked", "premature_finish", "uninformative_ask", "incomplete"],
  "Lost Memory": [
    "oscillation",
    "exploration",
    "repeated_failure",
    "stale_marker",
    "false_history",
    "repeated_call",
    "repeated_question",
    "door_closed_again",
    "undone_success",
  ],
  Other: ["timeout", "invalid_output", "physical_failure", "primitive_failure", "unexplained"],
};
