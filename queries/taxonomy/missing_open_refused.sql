-- missing_open_refused
--
-- The destination's closed door refused the target, which was put back for it: the door had to be opened while the hand was empty.
-- The decisive step is the refused placing.
--
-- Class: Key Action Missing
-- Sub-class: missing_open
-- Priority: 20
-- Needs: goal
SELECT sequence_find(steps, 'place[error_code = ''door_closed'']') AS found
FROM episodes
WHERE sequence_match(steps, 'place[error_code = ''door_closed''] !(open[ok] | place)* place[ok and put_back]')
  AND NOT sequence_match(steps, 'place[ok and goal_object and receptacle_match = ''dest'']')
