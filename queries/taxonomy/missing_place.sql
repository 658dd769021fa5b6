-- missing_place
--
-- The target was carried to its destination, and the episode finished with it in the hand: it was never placed, or every try
-- failed. The decisive step is `finish`.
--
-- Class: Key Action Missing
-- Sub-class: missing_place
-- Priority: 30
-- Needs: goal
SELECT sequence_find(steps, 'finish $') AS found
FROM episodes
WHERE sequence_match(steps, 'pick[ok and goal_object] !(pick[ok] | place[ok])* nav_to[receptacle_match = ''dest''] !place[ok]* finish[held is not null] $')
