-- exploration_given_up
--
-- The agent drove three times or more to where it did not stand, moved nothing, and finished: it had lost what it was after. The decisive step is
-- the first call of that stretch.
--
-- Class: Lost Memory
-- Sub-class: exploration
-- Priority: 38
-- Needs: goal
SELECT sequence_find(steps, 'nav_to (nav_to | show_object_by_category | walk_around | gaze_at | show_receptacles)* finish $') AS found
FROM episodes
WHERE sequence_match(steps, 'nav_to !(pick[ok] | place[ok] | open[ok] | close[ok])* nav_to[path_length_m <> path_length_m@-1 or path_length_m = 0] !(pick[ok] | place[ok] | open[ok] | close[ok])* nav_to[path_length_m <> path_length_m@-1 or path_length_m = 0] !(pick[ok] | place[ok] | open[ok] | close[ok])* finish $')
