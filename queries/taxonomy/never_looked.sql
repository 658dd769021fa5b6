-- never_looked
--
-- Nothing was picked, and no call looked for the target. The decisive step is the first call after those that went
-- somewhere: there it should have looked.
--
-- Class: Key Action Missing
-- Sub-class: never_looked
-- Priority: 30
SELECT coalesce(
  sequence_find(steps, '(pick | place | finish | open | close)'),
  named_struct('first', CAST(length - 1 AS INT), 'last', CAST(length - 1 AS INT))
) AS found
FROM episodes
WHERE NOT sequence_match(steps, 'show_object_by_category | gaze_at | walk_around | pick[ok]')
  AND NOT sequence_match(steps, '(nav_to nav_to){4,}')
