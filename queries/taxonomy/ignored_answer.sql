-- ignored_answer
--
-- The instruction fits several things, the user was asked and the answer told the target from them, and another object was taken
-- all the same. The decisive step is the last pick.
--
-- Class: Object Confusion
-- Sub-class: ignored_answer
-- Priority: 12
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match in (''instance'', ''category'', ''distractor'')] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
WHERE fuzzy AND sequence_match(steps, 'ask[ok and settles] .. pick[ok and not goal_object] !(pick[ok] | place[put_back])* $')
