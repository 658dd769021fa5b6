-- premature_finish
--
-- `finish` in the middle of the work: nothing picked yet, or put back where it was, or the target in the hand but not yet at
-- the destination. A number that is not on the map, and nothing done after it, explains more where
-- nothing was picked. The decisive step is `finish`.
--
-- Class: Key Action Missing
-- Sub-class: premature_finish
-- Priority: 35
-- Needs: goal
SELECT sequence_find(steps, 'finish $') AS found
FROM episodes
WHERE sequence_match(steps, 'pick[ok and goal_object] !(pick[ok] | place[ok] | nav_to[receptacle_match = ''dest''])* finish[held is not null] $')
   OR sequence_match(steps, '(^ | place[put_back]) !(pick[ok] | place[ok])* finish $')
  AND NOT sequence_match(steps, '_[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')] !(pick[ok] | place[ok])* finish $')
