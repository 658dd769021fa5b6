-- wrong_instance
--
-- The last object in the hand is of the target's very asset, but another instance of it: where it stood was not told
-- apart. The decisive step is that pick.
--
-- Class: Object Confusion
-- Sub-class: wrong_instance
-- Priority: 21
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match = ''instance'' and not goal_object] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
