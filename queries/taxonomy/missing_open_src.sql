-- missing_open_src
--
-- The target stands behind a closed door that was never opened. The decisive step is the first drive there after
-- which a call failed, else the first drive there.
--
-- Class: Key Action Missing
-- Sub-class: missing_open
-- Priority: 19
-- Needs: goal
SELECT named_struct(
  'first',
  coalesce(
    sequence_find(steps, 'nav_to[receptacle_match = ''src''] !nav_to* _[failed]'),
    sequence_find(steps, 'nav_to[receptacle_match = ''src'']')
  )['first'],
  'last',
  CAST(length - 1 AS INT)
) AS found
FROM episodes
WHERE src_door = 'closed'
  AND NOT sequence_match(steps, 'open[ok and receptacle_match = ''src'']')
  AND NOT sequence_match(steps, 'pick[ok]')
  AND sequence_match(steps, 'nav_to[receptacle_match = ''src'']')
  AND NOT sequence_match(steps, '(nav_to nav_to){4,}')
  AND NOT sequence_match(steps, 'open[error_code in (''skill_failed'', ''backend_error'')]')
