-- missing_pick
--
-- The target was looked for where it stands but never picked, and the episode went on as if it were in the hand: to the
-- destination, or to place. Who tried to pick by a number of an old map had not forgotten to. The decisive step is the first of
-- these calls.
--
-- Class: Key Action Missing
-- Sub-class: missing_pick
-- Priority: 30
-- Needs: goal
SELECT named_struct(
  'first',
  coalesce(
    sequence_find(steps, 'gaze_at[object_match = ''target''] !(gaze_at[object_match = ''target''] | nav_to[receptacle_match = ''dest''])* nav_to[receptacle_match = ''dest'']'),
    sequence_find(steps, 'nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null] !nav_to[receptacle_match = ''dest'']* nav_to[receptacle_match = ''dest'']'),
    sequence_find(steps, 'place[error_code = ''nothing_held'']')
  )['last'],
  'last',
  CAST(length - 1 AS INT)
) AS found
FROM episodes
WHERE NOT sequence_match(steps, 'pick[ok]')
  AND NOT sequence_match(steps, 'pick[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')]')
  AND (
    sequence_match(steps, 'gaze_at[object_match = ''target''] .. nav_to[receptacle_match = ''dest'']')
    OR sequence_match(steps, 'nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null] .. nav_to[receptacle_match = ''dest''] !nav_to* (place | finish)')
    OR sequence_match(steps, 'nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null] .. place[error_code = ''nothing_held'']')
  )
