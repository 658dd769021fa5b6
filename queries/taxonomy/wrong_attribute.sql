-- wrong_attribute
--
-- The last object in the hand is of the target's category, or one that is like it on purpose, but another asset:
-- colour, shape or size were not told apart (paper, Wrong Object Selection). The decisive step is that pick.
--
-- Class: Object Confusion
-- Sub-class: wrong_attribute
-- Priority: 21
-- Needs: goal
SELECT sequence_find(steps, 'pick[ok and object_match in (''category'', ''distractor'')] !(pick[ok] | place[put_back])* $') AS found
FROM episodes
