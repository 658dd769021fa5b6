-- missing_open_dest
--
-- The destination has a closed door that was never opened, though the target was in the hand. The decisive step is the
-- first call that met a closed door, else the first one that went to the destination with the target.
--
-- Class: Key Action Missing
-- Sub-class: missing_open
-- Priority: 19
-- Needs: goal
SELECT named_struct(
  'first',
  coalesce(
    sequence_find(steps, '_[error_code = ''door_closed'']'),
    sequence_find(steps, 'nav_to[ok and receptacle_match = ''dest'' and held is not null]')
  )['first'],
  'last',
  CAST(length - 1 AS INT)
) AS found
FROM episodes
WHERE dest_door = 'closed'
  AND NOT sequence_match(steps, 'open[ok and receptacle_match = ''dest'']')
  AND sequence_match(steps, 'pick[ok and goal_object] !pick[ok]* nav_to[ok and receptacle_match = ''dest'']')
  AND NOT sequence_match(steps, 'place[ok and goal_object]')
  AND NOT sequence_match(steps, 'open[error_code in (''skill_failed'', ''backend_error'')]')
