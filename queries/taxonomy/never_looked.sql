-- never_looked
--
-- Nothing was picked, and no call looked for the target, without eight drives in a row. The decisive step is the first try to pick or place all the same, else the
-- call with which it should have looked: the first other one at the source; else `finish`.
--
-- Class: Key Action Missing
-- Sub-class: never_looked
-- Priority: 30
-- Needs: goal
SELECT coalesce(
  sequence_find(steps, 'place[failed] | pick[failed]'),
  CASE WHEN sequence_match(steps, 'nav_to[ok and receptacle_match = ''src'']') THEN named_struct(
    'first', sequence_find(steps, 'nav_to[ok and receptacle_match = ''src''] (show_receptacles | open[ok])* !(show_receptacles | open[ok])').last,
    'last', sequence_find(steps, 'nav_to[ok and receptacle_match = ''src''] (show_receptacles | open[ok])* !(show_receptacles | open[ok])').last
  ) END,
  sequence_find(steps, 'finish')
) AS found
FROM episodes
WHERE NOT sequence_match(steps, 'pick[ok]')
  AND NOT sequence_match(
    steps,
    '_[tool in (''show_object_by_category'', ''gaze_at'', ''walk_around'') and (error_code is null or error_code = ''nothing_found'')]'
  )
  AND NOT sequence_match(steps, '(nav_to nav_to){4,}')
