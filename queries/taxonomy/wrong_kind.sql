-- wrong_kind
--
-- The last object in the hand is of quite another category than the target. The decisive step is that pick.
--
-- Class: Object Confusion
-- Sub-class: wrong_kind
-- Priority: 21
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match = ''other'' and not goal_object] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
