-- uninformative_ask
--
-- The instruction fits several things; the user was asked, but no answer told the target from what else was seen, and another
-- object was taken. The decisive step is that pick: the question that was needed is still missing there.
--
-- Class: Key Action Missing
-- Sub-class: uninformative_ask
-- Priority: 11
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match in (''instance'', ''category'', ''distractor'')] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
WHERE fuzzy
  AND sequence_match(steps, '^ !ask[ok and settles]* ask[ok and settles is not true] !ask[ok and settles]* pick[ok and not goal_object] !(pick[ok] | place[put_back])* $')
