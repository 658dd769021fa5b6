-- missing_pick
--
-- The target was looked for but never picked, and the episode went on as if it were in the hand: to the destination, or
-- to place. The decisive step is the first of these calls.
--
-- Class: Key Action Missing
-- Sub-class: missing_pick
-- Priority: 30
SELECT coalesce(
  sequence_find(steps, 'nav_to[receptacle_like = ''dest''] !nav_to* (place | finish)'),
  sequence_find(steps, 'place[error_code = ''nothing_held'']')
) AS found
FROM episodes
WHERE NOT sequence_match(steps, 'pick')
  AND sequence_match(steps, 'show_object_by_category | gaze_at | walk_around')
