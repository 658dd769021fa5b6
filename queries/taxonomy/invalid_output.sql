-- invalid_output
--
-- Output that is no call, unknown tools or bad arguments: two or more, and up to the end they outnumber all other calls, `finish`
-- among them. Where to look or what to pick next was still open, so this comes before what was left out. The decisive step is the
-- first of them.
--
-- Class: Other
-- Sub-class: invalid_output
-- Priority: 23
-- Needs: goal
SELECT named_struct(
  'first', prevailing_tail(steps, '[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]').onset,
  'last', prevailing_tail(steps, '[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]').last
) AS found
FROM episodes
WHERE prevailing_tail(steps, '[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]').margin >= 2
   OR prevailing_tail(steps, '[error_code in (''unparsable_output'', ''unknown_tool'', ''bad_arguments'')]').margin = 1 AND sequence_match(steps, 'finish $')
