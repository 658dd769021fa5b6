-- invalid_output
--
-- Output that is no call, unknown tools or bad arguments, three times or more, and nothing was done after it. The
-- decisive step is the first of them.
--
-- Class: Other
-- Sub-class: invalid_output
-- Priority: 23
SELECT sequence_find(
  steps,
  '_[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')] !(pick[ok] | place[ok] | nav_to[ok] | ask[ok])* $'
) AS found
FROM episodes
WHERE sequence_count(steps, '_[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]') >= 3
