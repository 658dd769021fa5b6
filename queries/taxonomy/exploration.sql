-- exploration
--
-- The budget was spent on going around and looking, and nothing was picked. The decisive step is the first call of the
-- last stretch in which nothing else was done.
--
-- Class: Lost Memory
-- Sub-class: exploration
-- Priority: 32
-- Needs: goal
SELECT sequence_find(steps, '(nav_to | show_object_by_category | walk_around | gaze_at | show_receptacles)+ $') AS found
FROM episodes
WHERE end_reason = 'horizon'
  AND NOT sequence_match(steps, 'pick[ok]')
  AND sequence_count(steps, 'nav_to[ok]') >= 8
