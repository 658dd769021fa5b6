-- repeated_failure
--
-- The same call with the same arguments failed three times or more in a row, and nothing was done after it: the
-- failures before were forgotten. The decisive step is the first of them.
--
-- Class: Lost Memory
-- Sub-class: repeated_failure
-- Priority: 21
SELECT sequence_find(
  steps,
  '_[error_code not in (''unknown_tool'', ''bad_arguments'', ''unparsable_output'', ''backend_error'', ''door_closed'', ''nothing_held'', ''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')] _[failed and tool = tool@-1 and arguments = arguments@-1 and error_code = error_code@-1]{2,} !_[ok and tool in (''pick'', ''place'', ''gaze_at'', ''show_object_by_category'', ''ask'', ''open'')]* $'
) AS found
FROM episodes
