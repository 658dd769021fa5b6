-- missing_ask
--
-- The instruction fits several things, nobody was asked before, and the wrong one was taken: the last object in the
-- hand is none that the goal moves. Outranks Object Confusion, although the wrong object was taken (paper, Qualitative
-- Analysis, Key Action Missing). The decisive step is that pick.
--
-- Class: Key Action Missing
-- Sub-class: missing_ask
-- Priority: 10
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match in (''instance'', ''category'', ''distractor'')] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
WHERE fuzzy AND NOT sequence_match(steps, 'ask[ok] .. pick[ok and not goal_object] !(pick[ok] | place[put_back])* $')
