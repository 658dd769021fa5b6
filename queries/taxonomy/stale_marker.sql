-- stale_marker
--
-- A number that is not on the current map was used, and no call by a number succeeded after it: the agent, which had looked
-- where the target stands, did not find back to what it had seen. A door that could not be closed does not count: success needs none closed. The decisive step is the
-- first use after the last call by a number that succeeded.
--
-- Class: Lost Memory
-- Sub-class: stale_marker
-- Priority: 34
-- Needs: goal
SELECT sequence_find(
  steps,
  '_[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'') and tool <> ''close''] !_[ok and tool in (''pick'', ''place'', ''gaze_at'', ''open'')]* $'
) AS found
FROM episodes
WHERE sequence_match(
  steps,
  'pick[ok] | gaze_at[object_match = ''target''] | nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null]'
)
