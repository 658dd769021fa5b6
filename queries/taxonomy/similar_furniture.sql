-- similar_furniture
--
-- The target was put, and left, on furniture of the destination's category, or on one that is like it on purpose
-- (paper, Similar Furniture Confusion). The decisive step is that placing.
--
-- Class: Object Confusion
-- Sub-class: similar_furniture
-- Priority: 21
-- Needs: goal
SELECT sequence_find(steps, 'place[ok and goal_object and receptacle_match = ''similar''] !(pick[ok and goal_object] | place[ok and goal_object])* $') AS found
FROM episodes
