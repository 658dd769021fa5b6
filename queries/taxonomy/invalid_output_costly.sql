-- invalid_output_costly
--
-- Output that is no call, unknown tools or bad arguments took three decisions or more, and the decisions ran out. The decisive step
-- is the first of them.
--
-- Class: Other
-- Sub-class: invalid_output
-- Priority: 45
-- Needs: goal
SELECT sequence_find(steps, '_[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]') AS found
FROM episodes
WHERE end_reason = 'horizon'
  AND sequence_count(steps, '_[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]') >= 3
