-- repeated_failure
--
-- Calls that had failed before in the same state of the world fail again, and prevail up to the end: the failures before were
-- forgotten. Errors that say what was left out (a closed door, an empty or full hand, a number of an
-- old map) or that are none of the agent's decisions do not count. The decisive step is the first repetition.
--
-- Class: Lost Memory
-- Sub-class: repeated_failure
-- Priority: 21
-- Needs: goal
SELECT prevailing_tail(
  steps,
  '[repeated and failed and error_code not in (''unknown_tool'', ''bad_arguments'', ''unparsable_output'', ''backend_error'', ''skill_failed'', ''door_closed'', ''nothing_held'', ''hand_not_free'', ''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')]'
) AS found
FROM episodes
WHERE prevailing_tail(
  steps,
  '[repeated and failed and error_code not in (''unknown_tool'', ''bad_arguments'', ''unparsable_output'', ''backend_error'', ''skill_failed'', ''door_closed'', ''nothing_held'', ''hand_not_free'', ''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')]'
).margin >= 2
  AND sequence_count(steps, '_[repeated and failed]') >= 2
