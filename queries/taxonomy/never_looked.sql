-- never_looked
--
-- Nothing was picked, and no call looked for the target. The decisive step is the first call after those that went
-- somewhere: there it should have looked.
--
-- Class: Key Action Missing
-- Sub-class: never_looked
-- Priority: 30
SELECT coalesce(
  sequence_find(steps, 'place[failed] | pick[failed]'),
  sequence_find(steps, 'finish')
) AS found
FROM episodes
WHERE NOT sequence_match(steps, 'pick[ok]')
  AND NOT sequence_match(
    steps,
    '_[tool in (''show_object_by_category'', ''gaze_at'', ''walk_around'') and (error_code is null or error_code = ''nothing_found'')]'
  )
  AND NOT sequence_match(steps, '(nav_to nav_to){4,}')
