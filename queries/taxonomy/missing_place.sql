-- missing_place
--
-- The target was carried to its destination and the episode finished without a try to place it there, or anywhere after. The decisive step is
-- `finish`.
--
-- Class: Key Action Missing
-- Sub-class: missing_place
-- Priority: 30
SELECT sequence_find(steps, 'finish $') AS found
FROM episodes
WHERE sequence_match(steps, 'pick[ok and goal_object] !(pick[ok] | place)* nav_to[receptacle_match = ''dest''] !place* finish[held is not null] $')
