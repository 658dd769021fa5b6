-- wrong_receptacle
--
-- The target was put, and left, on furniture that is neither the destination nor like it, the source among them. The decisive step is that
-- placing.
--
-- Class: Object Confusion
-- Sub-class: wrong_receptacle
-- Priority: 21
-- Needs: goal
SELECT sequence_find(steps, 'place[ok and goal_object and receptacle_match in (''src'', ''other'')] !(pick[ok and goal_object] | place[ok and goal_object])* $') AS found
FROM episodes
